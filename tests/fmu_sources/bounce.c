/* A ball under the acceleration u, which bounces at h = 0 and counts quarter seconds by time events.
 * Model exchange of FMI 1.0, 2.0 or 3.0 (-DFMI=1, 2, 3); with FMI 1.0 also co-simulation, without bounces.
 * Optional functions are left out on purpose: nominal values, states of the FMU, directional derivatives. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

typedef struct {
    double time, h, v, u, restitution, next;
    int count, mode; /* 0: before continuous time, 1: event mode, 2: continuous time */
    int fail;        /* 1: derivatives return an error from h below 0.2 on; 2: asks to end at the third time event */
} Ball;
enum { OK, WARNING, DISCARD, ERROR };

static Ball *make(void) {
    Ball *b = calloc(1, sizeof *b);
    b->h = 1.0;
    b->u = -9.81;
    b->restitution = 0.5;
    b->next = 0.25;
    return b;
}
static double *real(Ball *b, uint32_t r) {
    return r == 1 ? &b->h : r == 2 ? &b->v : r == 3 || r == 9 ? &b->u : r == 5 ? &b->restitution : NULL;
}
static void handle_events(Ball *b) {
    if (b->h <= 0.0 && b->v < 0.0) {
        b->h = 0.0;
        b->v = -b->restitution * b->v;
    }
    if (b->time >= b->next) {
        b->count++;
        b->next = 0.25 * (b->count + 1);
    }
}
static bool ends(const Ball *b) { return b->fail == 2 && b->count >= 3; }
static int derivatives(Ball *b, double *dx) {
    dx[0] = b->v;
    dx[1] = b->u;
    return b->fail == 1 && b->h < 0.2 ? ERROR : OK;
}
/* Above 0 where it stands still or rises, so that the ball that has just bounced crosses nothing. */
static double indicator(Ball *b) { return b->h == 0.0 && b->v > 0.0 ? 1.0 : b->h; }

static int get_reals(Ball *b, const uint32_t *r, size_t n, double *v) {
    for (size_t i = 0; i < n; i++) {
        double *p = real(b, r[i]);
        if (!p) return ERROR;
        v[i] = *p;
    }
    return OK;
}
static int set_reals(Ball *b, const uint32_t *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) {
        double *p = real(b, r[i]);
        if (!p || (r[i] == 3 && b->mode == 2)) return ERROR; /* u is discrete: in event mode only; 9 is not */
        *p = v[i];
    }
    return OK;
}
static int *integer(Ball *b, uint32_t r) { return r == 4 ? &b->count : r == 6 ? &b->fail : NULL; }

#if FMI == 1
#define NAME(f) Bounce_fmi##f
typedef struct {
    char converged, references_changed, values_changed, terminate, upcoming;
    double next;
} Info;
API const char *NAME(GetVersion)(void) { return "1.0"; }
API int NAME(GetReal)(Ball *b, const uint32_t *r, size_t n, double *v) {
    return b->mode ? get_reals(b, r, n, v) : ERROR; /* FMI 1.0: no reading before initialisation */
}
API int NAME(SetReal)(Ball *b, const uint32_t *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) {
        double *p = real(b, r[i]);
        if (!p) return ERROR;
        *p = v[i];
    }
    return OK;
}
API int NAME(GetInteger)(Ball *b, const uint32_t *r, size_t n, int *v) {
    for (size_t i = 0; i < n; i++) v[i] = *integer(b, r[i]);
    return OK;
}
API int NAME(SetInteger)(Ball *b, const uint32_t *r, size_t n, const int *v) {
    for (size_t i = 0; i < n; i++) *integer(b, r[i]) = v[i];
    return OK;
}
API int NAME(GetBoolean)(Ball *b, const uint32_t *r, size_t n, char *v) {
    for (size_t i = 0; i < n; i++) v[i] = b->v > 0.0;
    return OK;
}
static void note(Ball *b, Info *i) {
    memset(i, 0, sizeof *i);
    i->converged = i->upcoming = 1;
    i->next = b->next;
    i->terminate = ends(b);
}
API void *NAME(InstantiateModel)(const char *name, const char *guid) { return make(); }
API void NAME(FreeModelInstance)(Ball *b) { free(b); }
API int NAME(SetTime)(Ball *b, double t) { b->time = t; return OK; }
API int NAME(Initialize)(Ball *b, char controlled, double tolerance, Info *i) { b->mode = 2; note(b, i); return OK; }
API int NAME(EventUpdate)(Ball *b, char intermediate, Info *i) { handle_events(b); note(b, i); return OK; }
API int NAME(CompletedIntegratorStep)(Ball *b, char *event) { *event = 0; return OK; }
API int NAME(GetContinuousStates)(Ball *b, double *x, size_t n) { x[0] = b->h; x[1] = b->v; return OK; }
API int NAME(SetContinuousStates)(Ball *b, const double *x, size_t n) { b->h = x[0]; b->v = x[1]; return OK; }
API int NAME(GetDerivatives)(Ball *b, double *dx, size_t n) { return derivatives(b, dx); }
API int NAME(GetEventIndicators)(Ball *b, double *z, size_t n) { z[0] = indicator(b); return OK; }
API int NAME(Terminate)(Ball *b) { return OK; }

API void *NAME(InstantiateSlave)(const char *name, const char *guid) { return make(); }
API void NAME(FreeSlaveInstance)(Ball *b) { free(b); }
API int NAME(InitializeSlave)(Ball *b, double start, char stops, double stop) {
    b->mode = 2;
    return b->restitution < 0.0 ? ERROR : OK; /* refuses a negative parameter */
}
API int NAME(TerminateSlave)(Ball *b) { return OK; }
API int NAME(DoStep)(Ball *b, double t, double step, char fresh) {
    b->h += b->v * step + 0.5 * b->u * step * step;
    b->v += b->u * step;
    b->count++;
    return OK;
}
#endif

#if FMI == 2
typedef struct {
    int more, terminate, nominals, values, defined;
    double next;
} Info;
API const char *fmi2GetVersion(void) { return "2.0"; }
API void *fmi2Instantiate(const char *name, int type) { return type == 0 ? make() : NULL; }
API void fmi2FreeInstance(Ball *b) { free(b); }
API int fmi2SetupExperiment(Ball *b, int t, double tol, double start, int s, double stop) { b->time = start; return OK; }
API int fmi2EnterInitializationMode(Ball *b) { return OK; }
API int fmi2ExitInitializationMode(Ball *b) { b->mode = 1; return OK; }
API int fmi2Terminate(Ball *b) { return OK; }
API int fmi2GetReal(Ball *b, const uint32_t *r, size_t n, double *v) { return get_reals(b, r, n, v); }
API int fmi2SetReal(Ball *b, const uint32_t *r, size_t n, const double *v) { return set_reals(b, r, n, v); }
API int fmi2GetInteger(Ball *b, const uint32_t *r, size_t n, int *v) {
    for (size_t i = 0; i < n; i++) v[i] = *integer(b, r[i]);
    return OK;
}
API int fmi2SetInteger(Ball *b, const uint32_t *r, size_t n, const int *v) {
    for (size_t i = 0; i < n; i++) *integer(b, r[i]) = v[i];
    return OK;
}
API int fmi2EnterEventMode(Ball *b) { b->mode = 1; return OK; }
API int fmi2NewDiscreteStates(Ball *b, Info *i) {
    if (b->mode != 1) return ERROR;
    memset(i, 0, sizeof *i);
    handle_events(b);
    i->defined = 1;
    i->next = b->next;
    i->terminate = ends(b);
    return OK;
}
API int fmi2EnterContinuousTimeMode(Ball *b) { b->mode = 2; return OK; }
API int fmi2CompletedIntegratorStep(Ball *b, int free, int *event, int *stop) { *event = *stop = 0; return OK; }
API int fmi2SetTime(Ball *b, double t) { b->time = t; return OK; }
API int fmi2GetContinuousStates(Ball *b, double *x, size_t n) { x[0] = b->h; x[1] = b->v; return OK; }
API int fmi2SetContinuousStates(Ball *b, const double *x, size_t n) { b->h = x[0]; b->v = x[1]; return OK; }
API int fmi2GetDerivatives(Ball *b, double *dx, size_t n) { return derivatives(b, dx); }
API int fmi2GetEventIndicators(Ball *b, double *z, size_t n) { z[0] = indicator(b); return OK; }
#endif

#if FMI == 3
API const char *fmi3GetVersion(void) { return "3.0"; }
API void *fmi3InstantiateModelExchange(const char *name) { return make(); }
API void fmi3FreeInstance(Ball *b) { free(b); }
API int fmi3EnterInitializationMode(Ball *b, bool t, double tol, double start, bool s, double stop) {
    b->time = start;
    return OK;
}
API int fmi3ExitInitializationMode(Ball *b) { b->mode = 1; return OK; }
API int fmi3Terminate(Ball *b) { return OK; }
API int fmi3GetFloat64(Ball *b, const uint32_t *r, size_t n, double *v, size_t m) { return get_reals(b, r, n, v); }
API int fmi3SetFloat64(Ball *b, const uint32_t *r, size_t n, const double *v, size_t m) { return set_reals(b, r, n, v); }
API int fmi3GetInt32(Ball *b, const uint32_t *r, size_t n, int32_t *v, size_t m) {
    for (size_t i = 0; i < n; i++) v[i] = *integer(b, r[i]);
    return OK;
}
API int fmi3SetInt32(Ball *b, const uint32_t *r, size_t n, const int32_t *v, size_t m) {
    for (size_t i = 0; i < n; i++) *integer(b, r[i]) = v[i];
    return OK;
}
API int fmi3EnterEventMode(Ball *b) { b->mode = 1; return OK; }
API int fmi3UpdateDiscreteStates(Ball *b, bool *more, bool *stop, bool *nominals, bool *values, bool *defined,
                                 double *next) {
    if (b->mode != 1) return ERROR;
    handle_events(b);
    *more = *nominals = *values = false;
    *stop = ends(b);
    *defined = true;
    *next = b->next;
    return OK;
}
API int fmi3EnterContinuousTimeMode(Ball *b) { b->mode = 2; return OK; }
API int fmi3CompletedIntegratorStep(Ball *b, bool free, bool *event, bool *stop) { *event = *stop = false; return OK; }
API int fmi3SetTime(Ball *b, double t) { b->time = t; return OK; }
API int fmi3GetContinuousStates(Ball *b, double *x, size_t n) { x[0] = b->h; x[1] = b->v; return OK; }
API int fmi3SetContinuousStates(Ball *b, const double *x, size_t n) { b->h = x[0]; b->v = x[1]; return OK; }
API int fmi3GetContinuousStateDerivatives(Ball *b, double *dx, size_t n) { return derivatives(b, dx); }
API int fmi3GetEventIndicators(Ball *b, double *z, size_t n) { z[0] = indicator(b); return OK; }
#endif
