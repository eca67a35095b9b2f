/* An FMI 3.0 co-simulation FMU that calls back within its steps: x' = u^2 and y = u, integrated by Simpson's rule
 * over `parts` parts of each step. It asks for u at the middle and at the end of each part; `held` counts the
 * steps within which nothing was set. `limit` is the largest u that it takes. With early return it stops where
 * that is asked for. */
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
typedef void (*Update)(void *, double, bool, bool, bool, bool, bool *, double *);
typedef struct {
    double value[6]; /* by reference: u, x, y, limit, w (which nobody may set within a step), held */
    int32_t parts, held;
    bool early, within, set;
    size_t required;
    Update update;
    void *environment;
} Model;

API const char *fmi3GetVersion(void) { return "3.0"; }
API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                      bool logging, bool event_mode, bool early, const uint32_t *required,
                                      size_t n, void *environment, void *log, Update update) {
    Model *m = calloc(1, sizeof *m);
    m->value[3] = 1e9;
    m->parts = 8;
    m->early = early;
    m->required = n;
    m->update = update;
    m->environment = environment;
    return m;
}
API void fmi3FreeInstance(Model *m) { free(m); }
API int fmi3EnterInitializationMode(Model *m, bool t, double tol, double start, bool s, double stop) {
    return OK;
}
API int fmi3ExitInitializationMode(Model *m) { return OK; }
API int fmi3Terminate(Model *m) { return OK; }
API int fmi3GetFloat64(Model *m, const uint32_t *r, size_t n, double *v, size_t nv) {
    for (size_t i = 0; i < n; i++) {
        if (m->within && r[i] > 2) return ERROR; /* strict, as below */
        v[i] = r[i] == 2 ? m->value[0] : m->value[r[i]];
    }
    return OK;
}
API int fmi3SetFloat64(Model *m, const uint32_t *r, size_t n, const double *v, size_t nv) {
    for (size_t i = 0; i < n; i++) {
        if (m->within && r[i] != 0) return ERROR; /* strict: u alone may change within a step */
        if (r[i] == 0 && v[i] > m->value[3]) return ERROR;
        m->value[r[i]] = v[i];
    }
    m->set = true;
    return OK;
}
API int fmi3GetInt32(Model *m, const uint32_t *r, size_t n, int32_t *v, size_t nv) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 5 ? m->parts : r[i] == 6 ? m->held : (int32_t)m->required;
    return OK;
}
API int fmi3SetInt32(Model *m, const uint32_t *r, size_t n, const int32_t *v, size_t nv) {
    m->parts = v[0];
    return OK;
}
static double asked(Model *m, double time, bool finished, bool *stop) {
    bool wanted = false;
    double when = time;
    m->within = true;
    if (m->update)
        m->update(m->environment, time, true, finished, finished, finished && m->early, &wanted, &when);
    m->within = false;
    *stop = wanted && m->early && finished;
    return m->value[0] * m->value[0];
}
API int fmi3DoStep(Model *m, double t, double h, bool no_rollback, bool *event, bool *terminate, bool *early,
                   double *reached) {
    double part = h / m->parts;
    *event = *terminate = *early = false;
    *reached = t + h;
    m->set = false;
    for (int i = 0; i < m->parts; i++) {
        bool stop;
        double begin = m->value[0] * m->value[0], middle = asked(m, t + (i + 0.5) * part, false, &stop), end;
        double x = m->value[1];
        end = asked(m, t + (i + 1) * part, true, &stop);
        m->value[1] = x + part * (begin + 4 * middle + end) / 6;
        if (stop) {
            *early = true;
            *reached = t + (i + 1) * part;
            break;
        }
    }
    if (!m->set) m->held++;
    m->value[5] = m->held;
    return OK;
}
