/* Steps Windows libraries of FMUs: windows.exe JOBS, a text file.
 *
 * A job: name, FMI version (2 or 3), library, resources (a URI or a path), token; how many start values, and of each
 * its reference and value; how many inputs and their references; how many outputs and their references; how many
 * steps, their size, and for each step the values of the inputs. Every job prints its name and "begins", a line of
 * outputs per step, its name and "ends"; what goes wrong is printed to stderr, and ends that job. */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <windows.h>

enum { MOST = 512, TEXT = 1024 };

typedef struct {
    unsigned references[MOST];
    double values[MOST];
    int count;
} Group;

typedef struct {
    char name[TEXT], library[TEXT], resources[TEXT], token[TEXT];
    int version, steps;
    Group starts, inputs, outputs;
    double size, *fed;
} Job;

static void tell(const char *job, const char *what) {
    fprintf(stderr, "%s: %s\n", job, what);
    fflush(stderr);
}

static bool read_group(FILE *file, Group *group, bool valued) {
    if (fscanf(file, "%d", &group->count) != 1 || group->count > MOST) return false;
    for (int i = 0; i < group->count; i++) {
        if (fscanf(file, "%u", &group->references[i]) != 1) return false;
        if (valued && fscanf(file, "%lf", &group->values[i]) != 1) return false;
    }
    return true;
}

static bool read_job(FILE *file, Job *job) {
    if (fscanf(file, "%1023s %d %1023s %1023s %1023s", job->name, &job->version, job->library, job->resources,
               job->token) != 5)
        return false;
    if (!read_group(file, &job->starts, true) || !read_group(file, &job->inputs, false)) return false;
    if (!read_group(file, &job->outputs, false) || fscanf(file, "%d %lf", &job->steps, &job->size) != 2)
        return false;
    int count = job->steps * job->inputs.count;
    free(job->fed);
    job->fed = malloc((count + 1) * sizeof(double));
    for (int i = 0; i < count; i++)
        if (fscanf(file, "%lf", &job->fed[i]) != 1) return false;
    return true;
}

static double *inputs_of(const Job *job, int step) { return job->fed + step * job->inputs.count; }

static void print_outputs(const Job *job) {
    for (int i = 0; i < job->outputs.count; i++) printf("%.17g ", job->outputs.values[i]);
    printf("\n");
}

/* Looks up a function under its own name; where it is missing, that ends the job. */
#define FIND(type, name)                                      \
    type name = (type)(void *)GetProcAddress(library, #name); \
    if (!name) return "has no " #name
/* 0 is OK, 1 a warning. */
#define DO(call) \
    if ((call) > 1) return "fails: " #call

static void log2(void *where, const char *name, int status, const char *category, const char *message, ...) {
    tell(name, message);
}
static void *allocate(size_t count, size_t size) { return calloc(count, size); }

typedef struct {
    void (*log)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *finished, *environment;
} Callbacks;

typedef int (*Plain)(void *);
typedef void (*Free)(void *);

static const char *run2(HMODULE library, Job *job) {
    typedef void *(*Make)(const char *, int, const char *, const char *, const Callbacks *, int, int);
    typedef int (*Setup)(void *, int, double, double, int, double);
    typedef int (*Values)(void *, const unsigned *, size_t, double *);
    typedef int (*Step)(void *, double, double, int);
    static const Callbacks callbacks = {log2, allocate, free, NULL, NULL};
    FIND(Make, fmi2Instantiate);
    FIND(Setup, fmi2SetupExperiment);
    FIND(Plain, fmi2EnterInitializationMode);
    FIND(Plain, fmi2ExitInitializationMode);
    FIND(Values, fmi2SetReal);
    FIND(Values, fmi2GetReal);
    FIND(Step, fmi2DoStep);
    FIND(Plain, fmi2Terminate);
    FIND(Free, fmi2FreeInstance);
    void *one = fmi2Instantiate(job->name, 1, job->token, job->resources, &callbacks, 0, 1);
    if (!one) return "makes no instance";
    Group *starts = &job->starts, *in = &job->inputs, *out = &job->outputs;
    if (starts->count) DO(fmi2SetReal(one, starts->references, starts->count, starts->values));
    DO(fmi2SetupExperiment(one, 0, 0, 0, 0, 0));
    DO(fmi2EnterInitializationMode(one));
    DO(fmi2ExitInitializationMode(one));
    for (int step = 0; step < job->steps; step++) {
        if (in->count) DO(fmi2SetReal(one, in->references, in->count, inputs_of(job, step)));
        DO(fmi2DoStep(one, step * job->size, job->size, 1));
        DO(fmi2GetReal(one, out->references, out->count, out->values));
        print_outputs(job);
    }
    DO(fmi2Terminate(one));
    fmi2FreeInstance(one);
    return NULL;
}

static void log3(void *name, int status, const char *category, const char *message) { tell(name, message); }

static const char *run3(HMODULE library, Job *job) {
    typedef void *(*Make)(const char *, const char *, const char *, bool, bool, bool, bool, const unsigned *,
                          size_t, void *, void (*)(void *, int, const char *, const char *), void *);
    typedef int (*Enter)(void *, bool, double, double, bool, double);
    typedef int (*Values)(void *, const unsigned *, size_t, double *, size_t);
    typedef int (*Step)(void *, double, double, bool, bool *, bool *, bool *, double *);
    FIND(Make, fmi3InstantiateCoSimulation);
    FIND(Enter, fmi3EnterInitializationMode);
    FIND(Plain, fmi3ExitInitializationMode);
    FIND(Values, fmi3SetFloat64);
    FIND(Values, fmi3GetFloat64);
    FIND(Step, fmi3DoStep);
    FIND(Plain, fmi3Terminate);
    FIND(Free, fmi3FreeInstance);
    bool event, end, early;
    double reached;
    void *one = fmi3InstantiateCoSimulation(job->name, job->token, job->resources, false, true, false, false, NULL,
                                            0, job->name, log3, NULL);
    if (!one) return "makes no instance";
    Group *starts = &job->starts, *in = &job->inputs, *out = &job->outputs;
    if (starts->count) DO(fmi3SetFloat64(one, starts->references, starts->count, starts->values, starts->count));
    DO(fmi3EnterInitializationMode(one, false, 0, 0, false, 0));
    DO(fmi3ExitInitializationMode(one));
    for (int step = 0; step < job->steps; step++) {
        if (in->count) DO(fmi3SetFloat64(one, in->references, in->count, inputs_of(job, step), in->count));
        DO(fmi3DoStep(one, step * job->size, job->size, true, &event, &end, &early, &reached));
        DO(fmi3GetFloat64(one, out->references, out->count, out->values, out->count));
        print_outputs(job);
    }
    DO(fmi3Terminate(one));
    fmi3FreeInstance(one);
    return NULL;
}

int main(int count, char **words) {
    static Job job;
    FILE *file = count == 2 ? fopen(words[1], "r") : NULL;
    if (!file) return 2;
    while (read_job(file, &job)) {
        printf("%s begins\n", job.name);
        fflush(stdout);
        HMODULE library = LoadLibraryA(job.library);
        const char *failed = "does not load";
        if (library) failed = job.version == 3 ? run3(library, &job) : run2(library, &job);
        if (failed) tell(job.name, failed);
        else printf("%s ends\n", job.name);
        fflush(stdout);
        if (library) FreeLibrary(library);
    }
    return 0;
}
