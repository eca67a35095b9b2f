/* An FMI 2.0 slave as cheap as can be: PORTS outputs that follow PORTS inputs. With LAG they follow as first-order
 * lags of 0.1 s, starting at 1, 2, ...; without, at once. References: inputs 0 .. PORTS-1, outputs PORTS .. 2 PORTS-1. */
#include <stdint.h>
#include <stdlib.h>

#define API __attribute__((visibility("default")))
typedef struct {
    double value[2 * PORTS];
} Model;

API const char *fmi2GetVersion(void) { return "2.0"; }
API const char *fmi2GetTypesPlatform(void) { return "default"; }
API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const void *callbacks,
                          int visible, int logging) {
    Model *m = calloc(1, sizeof *m);
    for (int i = 0; i < PORTS; i++) {
        m->value[i] = 1.0;
        if (LAG) m->value[PORTS + i] = 1.0 + i;
    }
    return m;
}
API void fmi2FreeInstance(void *m) { free(m); }
API int fmi2SetDebugLogging(void *m, int on, size_t n, const char *const *categories) { return 0; }
API int fmi2SetupExperiment(void *m, int d, double t, double start, int s, double stop) { return 0; }
API int fmi2EnterInitializationMode(void *m) { return 0; }
API int fmi2ExitInitializationMode(void *m) { return 0; }
API int fmi2Terminate(void *m) { return 0; }
API int fmi2Reset(void *m) { return 0; }
API int fmi2SetReal(void *v, const uint32_t *r, size_t n, const double *x) {
    Model *m = v;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= 2 * PORTS) return 3;
        m->value[r[i]] = x[i];
    }
    return 0;
}
API int fmi2GetReal(void *v, const uint32_t *r, size_t n, double *x) {
    Model *m = v;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= 2 * PORTS) return 3;
#if !LAG
        if (r[i] >= PORTS) {
            x[i] = m->value[r[i] - PORTS];
            continue;
        }
#endif
        x[i] = m->value[r[i]];
    }
    return 0;
}
#define ABSENT(NAME, TYPE)                                                                                      \
    API int fmi2Get##NAME(void *m, const uint32_t *r, size_t n, TYPE *x) { return n ? 3 : 0; }                   \
    API int fmi2Set##NAME(void *m, const uint32_t *r, size_t n, const TYPE *x) { return n ? 3 : 0; }
ABSENT(Integer, int)
ABSENT(Boolean, int)
ABSENT(String, const char *)
API int fmi2GetFMUstate(void *m, void **state) { return 3; }
API int fmi2SetFMUstate(void *m, void *state) { return 3; }
API int fmi2FreeFMUstate(void *m, void **state) { return 3; }
API int fmi2SerializedFMUstateSize(void *m, void *state, size_t *size) { return 3; }
API int fmi2SerializeFMUstate(void *m, void *state, char *bytes, size_t size) { return 3; }
API int fmi2DeSerializeFMUstate(void *m, const char *bytes, size_t size, void **state) { return 3; }
API int fmi2GetDirectionalDerivative(void *m, const uint32_t *z, size_t nz, const uint32_t *v, size_t nv,
                                     const double *dv, double *dz) {
    return 3;
}
API int fmi2SetRealInputDerivatives(void *m, const uint32_t *r, size_t n, const int *order, const double *x) {
    return 3;
}
API int fmi2GetRealOutputDerivatives(void *m, const uint32_t *r, size_t n, const int *order, double *x) {
    return 3;
}
API int fmi2CancelStep(void *m) { return 3; }
API int fmi2GetStatus(void *m, int kind, int *x) { return 3; }
API int fmi2GetRealStatus(void *m, int kind, double *x) { return 3; }
API int fmi2GetIntegerStatus(void *m, int kind, int *x) { return 3; }
API int fmi2GetBooleanStatus(void *m, int kind, int *x) { return 3; }
API int fmi2GetStringStatus(void *m, int kind, const char **x) { return 3; }
API int fmi2DoStep(void *v, double time, double h, int no_rollback) {
#if LAG
    Model *m = v;
    for (int i = 0; i < PORTS; i++) m->value[PORTS + i] += h * 10.0 * (m->value[i] - m->value[PORTS + i]);
#endif
    return 0;
}
