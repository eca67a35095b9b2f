/* An FMI 3.0 co-simulation FMU whose arrays have the size of the structural parameter n: y = 2 * u, sum = sum of u.
 * `message` is what `heard` was, backwards, at the end of a step. */
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

enum { OK, WARNING, DISCARD, ERROR };
enum { MOST = 16 };
typedef struct {
    uint64_t n;
    double u[MOST];
    uint8_t heard[MOST], message[MOST];
    size_t length, told;
    bool configuring, initialised;
} Model;

API const char *fmi3GetVersion(void) { return "3.0"; }
API void *fmi3InstantiateCoSimulation(const char *name) {
    Model *m = calloc(1, sizeof *m);
    m->n = 2;
    for (int i = 0; i < MOST; i++) m->u[i] = 1;
    memcpy(m->message, "\1\0\2", 3);
    m->told = 3;
    return m;
}
API void fmi3FreeInstance(Model *m) { free(m); }
API int fmi3EnterConfigurationMode(Model *m) {
    if (m->initialised) return ERROR;
    m->configuring = true;
    return OK;
}
API int fmi3ExitConfigurationMode(Model *m) { m->configuring = false; return OK; }
API int fmi3EnterInitializationMode(Model *m) { m->initialised = true; return m->configuring ? ERROR : OK; }
API int fmi3ExitInitializationMode(Model *m) { return OK; }
API int fmi3Terminate(Model *m) { return OK; }
API int fmi3SetUInt64(Model *m, const uint32_t *r, size_t n, const uint64_t *v, size_t k) {
    if (!m->configuring || v[0] > MOST) return ERROR; /* structural parameters: in configuration mode only */
    m->n = v[0];
    return OK;
}
API int fmi3GetUInt64(Model *m, const uint32_t *r, size_t n, uint64_t *v, size_t k) { v[0] = m->n; return OK; }
API int fmi3SetFloat64(Model *m, const uint32_t *r, size_t n, const double *v, size_t k) {
    if (n != 1 || r[0] != 2 || k != m->n) return ERROR;
    memcpy(m->u, v, k * sizeof *v);
    return OK;
}
API int fmi3GetFloat64(Model *m, const uint32_t *r, size_t n, double *v, size_t k) {
    size_t at = 0;
    for (size_t i = 0; i < n; i++) {
        double sum = 0;
        for (uint64_t j = 0; j < m->n; j++) {
            sum += m->u[j];
            if (r[i] == 2) v[at++] = m->u[j];
            if (r[i] == 3) v[at++] = 2 * m->u[j];
        }
        if (r[i] == 4) v[at++] = sum;
    }
    return at == k ? OK : ERROR;
}
API int fmi3SetBinary(Model *m, const uint32_t *r, size_t n, const size_t *sizes, const uint8_t *const *v, size_t k) {
    if (n != 1 || r[0] != 5 || sizes[0] > MOST) return ERROR;
    memcpy(m->heard, v[0], sizes[0]);
    m->length = sizes[0];
    return OK;
}
API int fmi3GetBinary(Model *m, const uint32_t *r, size_t n, size_t *sizes, const uint8_t **v, size_t k) {
    for (size_t i = 0; i < n; i++) {
        sizes[i] = r[i] == 5 ? m->length : m->told;
        v[i] = r[i] == 5 ? m->heard : m->message;
    }
    return OK;
}
API int fmi3DoStep(Model *m, double t, double h, bool no_rollback, bool *event, bool *terminate, bool *early,
                   double *reached) {
    if (m->length) {
        for (size_t i = 0; i < m->length; i++) m->message[i] = m->heard[m->length - 1 - i];
        m->told = m->length;
    }
    *event = *terminate = *early = false;
    *reached = t + h;
    return OK;
}
