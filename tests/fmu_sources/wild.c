/* An FMI 2.0 co-simulation FMU that integrates u and misbehaves at the time `at` in the way it is told to.
 * It has none of the functions that FMI lets an FMU do without here: strings, states, derivatives. */
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING };
enum { WELL, CRASH, HANG, LATER, LEAVE };
typedef struct {
    double u, y, at, due;
    int way, asked;
} Wild;

API const char *fmi2GetVersion(void) { return "2.0"; }
API void *fmi2Instantiate(const char *name) { return calloc(1, sizeof(Wild)); }
API void fmi2FreeInstance(Wild *w) { free(w); }
API int fmi2SetupExperiment(Wild *w, int t, double tol, double start, int s, double stop) { return OK; }
API int fmi2EnterInitializationMode(Wild *w) { return OK; }
API int fmi2ExitInitializationMode(Wild *w) { return OK; }
API int fmi2Terminate(Wild *w) { return OK; }
static double *real(Wild *w, uint32_t r) { return r == 1 ? &w->u : r == 2 ? &w->y : &w->at; }
API int fmi2GetReal(Wild *w, const uint32_t *r, size_t n, double *v) {
    for (size_t i = 0; i < n; i++) v[i] = *real(w, r[i]);
    return OK;
}
API int fmi2SetReal(Wild *w, const uint32_t *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) *real(w, r[i]) = v[i];
    return OK;
}
API int fmi2GetInteger(Wild *w, const uint32_t *r, size_t n, int *v) {
    for (size_t i = 0; i < n; i++) v[i] = w->way;
    return OK;
}
API int fmi2SetInteger(Wild *w, const uint32_t *r, size_t n, const int *v) {
    for (size_t i = 0; i < n; i++) w->way = v[i];
    return OK;
}
API int fmi2DoStep(Wild *w, double t, double step, int free) {
    if (w->way && t >= w->at - 1e-9) {
        if (w->way == CRASH) {
            fprintf(stderr, "about to write to nowhere\n");
            fflush(stderr);
            *(volatile int *)8 = 1;
        }
        if (w->way == HANG)
            for (volatile int on = 1; on;) {}
        if (w->way == LEAVE) exit(3);
        if (w->way == LATER) {
            w->due = step;
            w->asked = 0;
            return PENDING;
        }
    }
    printf("a line on the standard output\n");
    fflush(stdout);
    w->y += w->u * step;
    return OK;
}
API int fmi2GetStatus(Wild *w, int kind, int *status) {
    if (kind != 0) return ERROR;
    if (w->asked++ < 3) {
        *status = PENDING;
        return OK;
    }
    w->y += w->u * w->due;
    *status = OK;
    return OK;
}
