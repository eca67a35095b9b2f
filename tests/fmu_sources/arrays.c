/* An FMI 3.0 co-simulation FMU with arrays: y = gain * u, row by row, gain of shape (2, 3), u of length 3.
 * `count` counts events, which come every 0.3 s, on from the tolerance that it is told, in 1e-9. With event mode it
 * returns early at each and counts when its discrete states are updated; without, it counts within the step. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

enum { OK, WARNING, DISCARD, ERROR };
typedef struct {
    double gain[6], u[3], y[2];
    int32_t count;
    bool event_mode, early, in_event, ready;
    int updates;
} Model;

API const char *fmi3GetVersion(void) { return "3.0"; }
API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                      bool logging, bool event_mode, bool early) {
    Model *m = calloc(1, sizeof *m);
    m->event_mode = event_mode;
    m->early = early;
    for (int i = 0; i < 6; i++) m->gain[i] = i + 1;
    for (int i = 0; i < 3; i++) m->u[i] = 1;
    return m;
}
API void fmi3FreeInstance(Model *m) { free(m); }
static void output(Model *m) {
    for (int i = 0; i < 2; i++) {
        m->y[i] = 0;
        for (int j = 0; j < 3; j++) m->y[i] += m->gain[3 * i + j] * m->u[j];
    }
}
API int fmi3EnterInitializationMode(Model *m, bool t, double tol, double start, bool s, double stop) {
    m->ready = true;
    if (t) m->count = (int32_t)(tol * 1e9 + 0.5);
    return OK;
}
API int fmi3ExitInitializationMode(Model *m) { m->in_event = m->event_mode; return OK; }
API int fmi3Terminate(Model *m) { return OK; }
static double *at(Model *m, uint32_t r, size_t *n) {
    *n = r == 1 ? 6 : r == 2 ? 3 : 2;
    return r == 1 ? m->gain : r == 2 ? m->u : m->y;
}
API int fmi3GetFloat64(Model *m, const uint32_t *r, size_t n, double *v, size_t nv) {
    size_t k = 0;
    if (!m->ready) return ERROR; /* strict: nothing is read before initialisation */
    output(m);
    for (size_t i = 0; i < n; i++) {
        size_t length;
        double *p = at(m, r[i], &length);
        for (size_t j = 0; j < length; j++) v[k++] = p[j];
    }
    return k == nv ? OK : ERROR;
}
API int fmi3SetFloat64(Model *m, const uint32_t *r, size_t n, const double *v, size_t nv) {
    size_t k = 0;
    for (size_t i = 0; i < n; i++) {
        size_t length;
        double *p = at(m, r[i], &length);
        for (size_t j = 0; j < length; j++) p[j] = v[k++];
    }
    return k == nv ? OK : ERROR;
}
API int fmi3GetInt32(Model *m, const uint32_t *r, size_t n, int32_t *v, size_t nv) { v[0] = m->count; return OK; }
API int fmi3EnterEventMode(Model *m) { m->in_event = true; return m->event_mode ? OK : ERROR; }
API int fmi3EnterStepMode(Model *m) { m->in_event = false; return m->event_mode ? OK : ERROR; }
static int due;
API int fmi3UpdateDiscreteStates(Model *m, bool *more, bool *stop, bool *nominals, bool *values, bool *defined,
                                 double *next) {
    if (!m->in_event) return ERROR;
    *stop = *nominals = *values = *defined = false;
    *more = due && m->updates++ % 2 == 0; /* takes two rounds to settle */
    if (due && !*more) {
        m->count++;
        due = 0;
    }
    return OK;
}
API int fmi3DoStep(Model *m, double t, double h, bool no_rollback, bool *event, bool *stop, bool *early,
                   double *reached) {
    double next = 0.3 * (m->count + 1);
    if (m->in_event) return ERROR;
    *event = *stop = *early = false;
    *reached = t + h;
    if (next <= t + h + 1e-9) {
        if (m->event_mode) {
            *event = true;
            due = 1;
            *early = m->early && next < t + h - 1e-9;
            if (*early) *reached = next;
        } else
            m->count++;
    }
    return OK;
}
