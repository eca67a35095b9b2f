/* A plain C master: Jacobi over FMI 2.0 slaves of one library, table-driven, statuses checked.
 * usage: master LIBRARY SLAVES PORTS STEPS STEP_SIZE RECORD CHECK SOURCE...
 * SOURCE: for each input the index of the output that feeds it, or -1 for a constant 1. RECORD: 0 nothing;
 * 1 all outputs at every point, in memory. CHECK: whether values must be finite. Prints CPU seconds of the loop, then the last outputs. */
#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef void *(*Instantiate)(const char *, int, const char *, const char *, const void *, int, int);
typedef int (*Setup)(void *, int, double, double, int, double);
typedef int (*Plain)(void *);
typedef int (*Set)(void *, const uint32_t *, size_t, const double *);
typedef int (*Get)(void *, const uint32_t *, size_t, double *);
typedef int (*Step)(void *, double, double, int);

static void *find(void *library, const char *name) {
    void *function = dlsym(library, name);
    if (!function) {
        fprintf(stderr, "no %s\n", name);
        exit(2);
    }
    return function;
}
static double cpu(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}
static void nothing() {}

int main(int count, char **text) {
    void *library = dlopen(text[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        return 2;
    }
    int slaves = atoi(text[2]), ports = atoi(text[3]), record = atoi(text[6]), check = atoi(text[7]), n = slaves * ports;
    long steps = atol(text[4]);
    double h = atof(text[5]);
    Set set = (Set)find(library, "fmi2SetReal");
    Get get = (Get)find(library, "fmi2GetReal");
    Step step = (Step)find(library, "fmi2DoStep");
    void *callbacks[5] = {(void *)nothing, (void *)calloc, (void *)free, NULL, NULL};
    void **slave = malloc(slaves * sizeof *slave);
    uint32_t *inputs = malloc(ports * sizeof *inputs), *outputs = malloc(ports * sizeof *outputs);
    int *source = malloc(n * sizeof *source);
    double *u = malloc(n * sizeof *u), *y = malloc(n * sizeof *y), *rows = NULL;
    for (int i = 0; i < ports; i++) inputs[i] = i, outputs[i] = ports + i;
    for (int i = 0; i < n; i++) source[i] = atoi(text[8 + i]), u[i] = 1.0;
    for (int s = 0; s < slaves; s++) {
        slave[s] = ((Instantiate)find(library, "fmi2Instantiate"))("s", 1, "lags", "", callbacks, 0, 0);
        ((Setup)find(library, "fmi2SetupExperiment"))(slave[s], 0, 0, 0, 0, 0);
        ((Plain)find(library, "fmi2EnterInitializationMode"))(slave[s]);
        set(slave[s], inputs, ports, u + s * ports);
        ((Plain)find(library, "fmi2ExitInitializationMode"))(slave[s]);
        get(slave[s], outputs, ports, y + s * ports);
    }
    if (record) rows = malloc((steps + 1) * (n + 1) * sizeof *rows);
    double begin = cpu();
    for (long k = 0; k < steps; k++) {
        double time = k * h;
        if (record) {
            double *row = rows + k * (n + 1);
            row[0] = time;
            memcpy(row + 1, y, n * sizeof *y);
        }
        for (int i = 0; i < n; i++)
            if (source[i] >= 0) u[i] = y[source[i]];
        for (int s = 0; s < slaves; s++) {
            if (set(slave[s], inputs, ports, u + s * ports) > 1) return 3;
            if (step(slave[s], time, h, 1) > 1) return 3;
            if (get(slave[s], outputs, ports, y + s * ports) > 1) return 3;
        }
        if (check) {
            int bad = 0;
            for (int i = 0; i < n; i++) bad |= !isfinite(y[i]);
            if (bad) return 4;
        }
    }
    double spent = cpu() - begin;
    if (record && rows[steps / 2 * (n + 1)] != steps / 2 * h) return 5; /* rows that nobody reads are not written */
    printf("%.9f", spent);
    for (int i = 0; i < n; i++) printf(" %.17g", y[i]);
    printf("\n");
    return 0;
}
