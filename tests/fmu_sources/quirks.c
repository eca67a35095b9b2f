/* An FMI 2.0 co-simulation FMU that integrates u and has the habit that its GUID names; what exporters are known
 * for. `seen` counts what the habit is about. It has no fmi2GetTypesPlatform, fmi2SetDebugLogging, fmi2Reset, no
 * strings, states, derivatives or statuses but that of the last time reached. */
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#include <direct.h>
#define chdir _chdir
#define API __declspec(dllexport)
#else
#include <unistd.h>
#define API __attribute__((visibility("default")))
#endif

enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING };
typedef void (*Logger)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *finished;
    void *environment;
} Callbacks;
typedef struct {
    const Callbacks *calls;
    char name[64], habit[64];
    double u, y, stop, reached;
    int seen, level, terminated, gain;
} Quirk;

#if defined(NEEDS_HELPER)
extern int helper(void);
#endif
static int is(const Quirk *q, const char *habit) { return strstr(q->habit, habit) != NULL; }

/* A file of the resources, whose URI is decoded as it should be or, by habit, only stripped of its scheme. */
static int first_number(const char *uri, int naive) {
    char path[4096];
    size_t n = 0;
    if (strncmp(uri, "file:///", 8) != 0) return -1;
#if defined(_WIN32)
    uri += 8;
#else
    uri += 7;
#endif
    for (; *uri && n < sizeof path - 32; uri++) {
        unsigned code;
        if (!naive && *uri == '%' && sscanf(uri + 1, "%2x", &code) == 1) {
            path[n++] = (char)code;
            uri += 2;
        } else
            path[n++] = *uri;
    }
    strcpy(path + n, "/table.txt");
    FILE *file = fopen(path, "r");
    int number = -2;
    if (file) {
        if (fscanf(file, "%d", &number) != 1) number = -3;
        fclose(file);
    }
    return number;
}

API const char *fmi2GetVersion(void) { return "2.0"; }
API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                          const Callbacks *calls, int visible, int logging) {
    Quirk *q = calls->allocate(1, sizeof *q);
    q->calls = calls;
    q->gain = 1;
    strncpy(q->name, name, sizeof q->name - 1);
    strncpy(q->habit, guid, sizeof q->habit - 1);
    if (is(q, "strict guid") && guid[0] != '{') return NULL;
    if (is(q, "bare guid") && guid[0] == '{') return NULL;
    if (is(q, "resources")) q->seen = first_number(resources, is(q, "naive"));
    if (is(q, "changes directory") && chdir("/") != 0) return NULL;
#if defined(NEEDS_HELPER)
    q->seen = helper();
#endif
    return q;
}
API void fmi2FreeInstance(Quirk *q) { q->calls->release(q); }
API int fmi2SetupExperiment(Quirk *q, int t, double tol, double start, int defined, double stop) {
    q->stop = stop; /* whether or not it is defined */
    q->seen += is(q, "stop") && defined;
    if (is(q, "tolerance")) q->seen = t ? (int)(tol * 1e9 + 0.5) : -1;
    return is(q, "warns") ? WARNING : OK;
}
API int fmi2EnterInitializationMode(Quirk *q) { return is(q, "warns") ? WARNING : OK; }
API int fmi2ExitInitializationMode(Quirk *q) { return is(q, "warns") ? WARNING : OK; }
API int fmi2Terminate(Quirk *q) {
    if (is(q, "dies at the end")) abort();
    return is(q, "fails at the end") ? ERROR : OK;
}
API int fmi2GetReal(Quirk *q, const uint32_t *r, size_t n, double *v) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 1 ? q->u : q->y;
    return OK;
}
API int fmi2SetReal(Quirk *q, const uint32_t *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) q->u = v[i];
    return OK;
}
API int fmi2GetInteger(Quirk *q, const uint32_t *r, size_t n, int *v) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 3 ? q->seen : r[i] == 4 ? q->level : q->gain;
    return OK;
}
API int fmi2SetInteger(Quirk *q, const uint32_t *r, size_t n, const int *v) {
    for (size_t i = 0; i < n; i++) *(r[i] == 4 ? &q->level : &q->gain) = v[i];
    return OK;
}
API int fmi2GetRealStatus(Quirk *q, int kind, double *v) {
    *v = q->reached;
    return OK;
}
API int fmi2DoStep(Quirk *q, double t, double h, int free) {
    const Callbacks *c = q->calls;
    if (is(q, "strict stop") && t + h > q->stop) return ERROR;
    if (is(q, "short steps") && h > 0.05) {
        q->reached = t + 0.05;
        return DISCARD;
    }
    if (is(q, "talks")) {
        static char longest[20001];
        c->logger(c->environment, q->name, OK, "all", "at %g s: %d of %s, %5.1f%% done", t, 3, "four", 75.0);
        c->logger(NULL, q->name, WARNING, NULL, "no environment, no category");
        c->logger(c->environment, NULL, WARNING, "", "");
        memset(longest, 'x', sizeof longest - 1);
        c->logger(c->environment, q->name, OK, "all", "%s", longest);
    }
    if (is(q, "changes directory") && chdir("/") != 0) return ERROR;
    q->y += q->gain * q->u * h;
    return is(q, "warns") ? WARNING : OK;
}
