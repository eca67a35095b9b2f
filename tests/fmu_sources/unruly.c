/* An integrator for FMI 2 (-DVERSION=2) or 3 that fails in the way and from the time that it is told to.
 * References: 0 rate, 1 level (its integral), 2 through (= rate), 3 at [s], 4 way, 5 count (steps taken).
 * It counts in 5 how often it was stepped, whatever comes of the step. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#define API __attribute__((visibility("default")))
enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { NOTHING, WARN, DISCARDS, FAILS, TERMINATES, NAN_LEVEL, SET_FAILS, GET_FAILS, COMPLAINS, ENDS };

#if VERSION == 2
typedef void (*Logger)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *finished, *environment;
} Callbacks;
#else
typedef void (*Logger)(void *, int, const char *, const char *);
#endif

typedef struct {
    double real[4];
    int32_t way, count;
    double time, reached;
    Logger logger;
    void *environment;
} Model;

static void tell(Model *m, int status, const char *text) {
#if VERSION == 2
    m->logger(m->environment, "unruly", status, "all", text);
#else
    m->logger(m->environment, status, "all", text);
#endif
}

static bool due(Model *m, int way) { return m->way == way && m->time >= m->real[3] - 1e-12; }

static Model *make(Logger logger, void *environment) {
    Model *m = calloc(1, sizeof *m);
    m->logger = logger;
    m->environment = environment;
    m->real[3] = 1e9;
    return m;
}

static int set_real(Model *m, const uint32_t *r, size_t n, const double *v) {
    if (due(m, SET_FAILS)) {
        tell(m, ERROR, "cannot be set");
        return ERROR;
    }
    for (size_t i = 0; i < n; i++) m->real[r[i]] = v[i];
    return OK;
}
static int get_real(Model *m, const uint32_t *r, size_t n, double *v) {
    if (due(m, GET_FAILS)) {
        tell(m, ERROR, "cannot be read");
        return ERROR;
    }
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 2 ? m->real[0] : m->real[r[i]];
    return OK;
}
static int set_int(Model *m, const uint32_t *r, size_t n, const int32_t *v) {
    for (size_t i = 0; i < n; i++) *(r[i] == 4 ? &m->way : &m->count) = v[i];
    return OK;
}
static int get_int(Model *m, const uint32_t *r, size_t n, int32_t *v) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 4 ? m->way : m->count;
    return OK;
}
static int step(Model *m, double time, double h) {
    m->count++;
    m->time = time;
    m->reached = due(m, ENDS) ? time + h : time;
    if (m->way == COMPLAINS && !isfinite(m->real[0])) {
        tell(m, ERROR, "the rate is no number");
        return ERROR;
    }
    if (due(m, DISCARDS)) return DISCARD;
    if (due(m, FAILS)) {
        tell(m, ERROR, "fails as told");
        return ERROR;
    }
    m->real[1] += m->real[0] * h;
    if (due(m, NAN_LEVEL)) m->real[1] = NAN;
    if (due(m, WARN)) {
        tell(m, WARNING, "goes on with a warning");
        return WARNING;
    }
    return OK;
}

#if VERSION == 2
API const char *fmi2GetVersion(void) { return "2.0"; }
API const char *fmi2GetTypesPlatform(void) { return "default"; }
API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const Callbacks *c,
                          int visible, int logging) {
    return make(c->logger, c->environment);
}
API void fmi2FreeInstance(void *m) { free(m); }
API int fmi2SetupExperiment(void *m, int d, double t, double start, int s, double stop) { return OK; }
API int fmi2EnterInitializationMode(void *m) { return OK; }
API int fmi2ExitInitializationMode(void *m) { return OK; }
API int fmi2Terminate(void *m) { return OK; }
API int fmi2SetReal(void *m, const uint32_t *r, size_t n, const double *v) { return set_real(m, r, n, v); }
API int fmi2GetReal(void *m, const uint32_t *r, size_t n, double *v) { return get_real(m, r, n, v); }
API int fmi2SetInteger(void *m, const uint32_t *r, size_t n, const int32_t *v) { return set_int(m, r, n, v); }
API int fmi2GetInteger(void *m, const uint32_t *r, size_t n, int32_t *v) { return get_int(m, r, n, v); }
API int fmi2GetBooleanStatus(void *v, int kind, int *value) {
    *value = due(v, TERMINATES) || due(v, ENDS);
    return OK;
}
API int fmi2GetRealStatus(void *v, int kind, double *value) {
    *value = ((Model *)v)->reached;
    return OK;
}
API int fmi2DoStep(void *v, double time, double h, int no_rollback) {
    int status = step(v, time, h);
    return due(v, TERMINATES) || due(v, ENDS) ? DISCARD : status;
}
#else
API const char *fmi3GetVersion(void) { return "3.0"; }
API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                      bool logging, bool event_mode, bool early_return, const uint32_t *required,
                                      size_t count, void *environment, Logger logger, void *update) {
    return make(logger, environment);
}
API void fmi3FreeInstance(void *m) { free(m); }
API int fmi3EnterInitializationMode(void *m, bool t, double tol, double start, bool s, double stop) { return OK; }
API int fmi3ExitInitializationMode(void *m) { return OK; }
API int fmi3Terminate(void *m) { return OK; }
API int fmi3SetFloat64(void *m, const uint32_t *r, size_t n, const double *v, size_t k) {
    return set_real(m, r, n, v);
}
API int fmi3GetFloat64(void *m, const uint32_t *r, size_t n, double *v, size_t k) { return get_real(m, r, n, v); }
API int fmi3SetInt32(void *m, const uint32_t *r, size_t n, const int32_t *v, size_t k) {
    return set_int(m, r, n, v);
}
API int fmi3GetInt32(void *m, const uint32_t *r, size_t n, int32_t *v, size_t k) { return get_int(m, r, n, v); }
API int fmi3DoStep(void *v, double time, double h, bool no_rollback, bool *event, bool *terminate, bool *early,
                   double *reached) {
    int status = step(v, time, h);
    *event = *early = false;
    *terminate = due(v, TERMINATES) || due(v, ENDS);
    *reached = ((Model *)v)->reached;
    return status;
}
#endif
