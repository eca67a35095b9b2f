/* An FMI 2.0 co-simulation FMU without dynamics: the real variable 100 + k gives what variable k was set to. */
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

typedef struct {
    double values[100];
} Echo;

API const char *fmi2GetVersion(void) { return "2.0"; }
API const char *fmi2GetTypesPlatform(void) { return "default"; }
API void *fmi2Instantiate(const char *name) { return calloc(1, sizeof(Echo)); }
API void fmi2FreeInstance(Echo *e) { free(e); }
API int fmi2SetupExperiment(Echo *e, int t, double tolerance, double start, int s, double stop) { return 0; }
API int fmi2EnterInitializationMode(Echo *e) { return 0; }
API int fmi2ExitInitializationMode(Echo *e) { return 0; }
API int fmi2Terminate(Echo *e) { return 0; }
API int fmi2SetReal(Echo *e, const uint32_t *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) e->values[r[i] % 100] = v[i];
    return 0;
}
API int fmi2GetReal(Echo *e, const uint32_t *r, size_t n, double *v) {
    for (size_t i = 0; i < n; i++) v[i] = e->values[r[i] % 100];
    return 0;
}
API int fmi2DoStep(Echo *e, double t, double step, int free) { return 0; }
