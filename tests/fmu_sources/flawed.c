/* An FMI 2.0 co-simulation FMU that integrates u and has the flaw that its GUID names; without one it is as strict
 * as the standard. y is the integral, z is 2 u at once. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { MADE, INITIALISING, STEPPING, TERMINATED };
typedef struct {
    void *logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
} Callbacks;
typedef struct {
    char flaw[32];
    int mode;
    double u, x, gain, last;
} Flawed;
typedef struct {
    double u, x, last;
    int mode;
} State;

static double shared;

static int is(const Flawed *f, const char *flaw) { return strcmp(f->flaw, flaw) == 0; }

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }
API int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const names[]) { return OK; }

static void begin(Flawed *f) {
    f->mode = MADE;
    f->u = f->x = f->last = 0.0;
    f->gain = 1.0;
}

API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                          const Callbacks *callbacks, int visible, int logging) {
    if (guid[0] == '{') return NULL; /* another FMU's: ours are names of flaws */
    Flawed *f = calloc(1, sizeof *f);
    strncpy(f->flaw, guid, sizeof f->flaw - 1);
    begin(f);
    return f;
}
API void fmi2FreeInstance(void *c) { free(c); }
API int fmi2SetupExperiment(void *c, int defined, double tolerance, double start, int stop_defined, double stop) {
    return ((Flawed *)c)->mode == MADE ? OK : ERROR;
}
API int fmi2EnterInitializationMode(void *c) {
    Flawed *f = c;
    if (f->mode != MADE) return ERROR;
    f->mode = INITIALISING;
    return OK;
}
API int fmi2ExitInitializationMode(void *c) {
    Flawed *f = c;
    if (f->mode != INITIALISING) return ERROR;
    f->mode = STEPPING;
    return OK;
}
API int fmi2Terminate(void *c) {
    Flawed *f = c;
    if (f->mode != STEPPING) return ERROR;
    f->mode = TERMINATED;
    return OK;
}
API int fmi2Reset(void *c) {
    Flawed *f = c;
    double x = f->x;
    begin(f);
    if (is(f, "reset")) f->x = x;
    return OK;
}

API int fmi2GetReal(void *c, const unsigned r[], size_t n, double v[]) {
    Flawed *f = c;
    for (size_t i = 0; i < n; i++) switch (r[i]) {
        case 1: v[i] = f->u; break;
        case 2:
            v[i] = is(f, "shared") ? shared : f->x;
            if (is(f, "random")) {
                struct timespec now;
                timespec_get(&now, TIME_UTC);
                v[i] += (double)now.tv_nsec;
            }
            if (is(f, "undeclared")) v[i] += f->u;
            if (is(f, "not finite")) v[i] = NAN;
            if (is(f, "inverse") && f->last > 0) v[i] = 1.0 / f->last;
            break;
        case 3: v[i] = 2.0 * f->u; break;
        case 4: v[i] = f->gain; break;
        default: return ERROR;
        }
    return OK;
}
API int fmi2SetReal(void *c, const unsigned r[], size_t n, const double v[]) {
    Flawed *f = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] == 1) f->u = v[i];
        else if (r[i] == 4 && f->mode != STEPPING) f->gain = v[i];
        else if (!is(f, "lax")) return ERROR;
    }
    return OK;
}
#define NO(name, type) \
    API int name(void *c, const unsigned r[], size_t n, type v[]) { return n ? ERROR : OK; }
NO(fmi2GetInteger, int)
NO(fmi2GetBoolean, int)
NO(fmi2GetString, const char *)
NO(fmi2SetInteger, const int)
NO(fmi2SetBoolean, const int)
NO(fmi2SetString, const char *const)

API int fmi2DoStep(void *c, double time, double step, int no_rollback) {
    Flawed *f = c;
    if (is(f, "always crashes")) abort();
    if (f->mode != STEPPING && is(f, "crashes early")) abort();
    if (f->mode != STEPPING && !is(f, "lax")) return ERROR;
    if (step <= 0 && !is(f, "lax")) return ERROR;
    if (isnan(f->u) && is(f, "hangs at NaN"))
        for (volatile int forever = 1; forever;) {}
    if (isnan(f->u) && is(f, "swallows NaN")) f->u = 0.0;
    if (f->u != 0.0 && is(f, "crashes when driven")) abort();
    f->x += f->gain * step * f->u;
    shared += step * f->u;
    f->last = step;
    return OK;
}
API int fmi2CancelStep(void *c) { return ERROR; }
API int fmi2GetRealOutputDerivatives(void *c, const unsigned r[], size_t n, const int o[], double v[]) { return ERROR; }
API int fmi2SetRealInputDerivatives(void *c, const unsigned r[], size_t n, const int o[], const double v[]) { return ERROR; }
API int fmi2GetStatus(void *c, int kind, int *v) { return DISCARD; }
API int fmi2GetRealStatus(void *c, int kind, double *v) { return DISCARD; }
API int fmi2GetIntegerStatus(void *c, int kind, int *v) { return DISCARD; }
API int fmi2GetBooleanStatus(void *c, int kind, int *v) { return DISCARD; }
API int fmi2GetStringStatus(void *c, int kind, const char **v) { return DISCARD; }

API int fmi2GetDirectionalDerivative(void *c, const unsigned z[], size_t nz, const unsigned v[], size_t nv,
                                     const double dv[], double dz[]) {
    Flawed *f = c;
    for (size_t i = 0; i < nz; i++) {
        dz[i] = 0.0;
        for (size_t k = 0; k < nv; k++)
            if (z[i] == 3 && v[k] == 1) dz[i] += (is(f, "derivative") ? 3.0 : 2.0) * dv[k];
    }
    return OK;
}

API int fmi2GetFMUstate(void *c, void **state) {
    Flawed *f = c;
    State *s = *state ? *state : malloc(sizeof *s);
    s->u = f->u, s->x = f->x, s->last = f->last, s->mode = f->mode;
    if (is(f, "saving")) f->x += 1.0;
    *state = s;
    return OK;
}
API int fmi2SetFMUstate(void *c, void *state) {
    Flawed *f = c;
    const State *s = state;
    f->u = s->u, f->last = s->last, f->mode = s->mode;
    if (!is(f, "state")) f->x = s->x;
    return OK;
}
API int fmi2FreeFMUstate(void *c, void **state) {
    free(*state);
    *state = NULL;
    return OK;
}
API int fmi2SerializedFMUstateSize(void *c, void *state, size_t *size) {
    *size = sizeof(State);
    return OK;
}
API int fmi2SerializeFMUstate(void *c, void *state, char data[], size_t size) {
    memcpy(data, state, sizeof(State));
    return OK;
}
API int fmi2DeSerializeFMUstate(void *c, const char data[], size_t size, void **state) {
    State *s = malloc(sizeof *s);
    memcpy(s, data, sizeof *s);
    if (is(c, "bytes")) s->x = 0.0;
    *state = s;
    return OK;
}
