/* An FMI 3.0 co-simulation FMU with variables of several types. Each output follows its input after a step;
 * real_out integrates real_in. It refuses steps longer than 0.25 s and fails when real_out passes 5. */
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

typedef void (*Logger)(void *, int, const char *, const char *);
typedef struct {
    double real_in, real_out, single_out, limit;
    float single_in;
    int8_t byte_in, byte_out;
    uint32_t count_in, count_out;
    int64_t level_in, level_out;
    bool flag_in, flag_out;
    char word_in[32], word_out[32];
} State;
typedef struct {
    State s;
    void *environment;
    Logger log;
} Model;

enum { OK, WARNING, DISCARD, ERROR, FATAL };

API const char *fmi3GetVersion(void) { return "3.0"; }

API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                      bool logging, bool event_mode, bool early_return, const uint32_t *required,
                                      size_t count, void *environment, Logger log, void *intermediate_update) {
    Model *m;
    if (strcmp(token, "{types-3}") != 0) {
        log(environment, ERROR, "error", "wrong instantiation token");
        return NULL;
    }
    m = calloc(1, sizeof *m);
    m->environment = environment;
    m->log = log;
    m->s.limit = 5.0;
    m->s.level_in = m->s.level_out = 1;
    strcpy(m->s.word_out, "nothing");
    return m;
}
API void fmi3FreeInstance(void *m) { free(m); }
API int fmi3EnterInitializationMode(void *m, bool t, double tol, double start, bool s, double stop) { return OK; }
API int fmi3ExitInitializationMode(void *m) { return OK; }
API int fmi3Terminate(void *m) { return OK; }
API int fmi3Reset(void *m) { return OK; }

#define ACCESS(NAME, TYPE, BODY)                                                                                \
    static TYPE *at_##NAME(Model *m, uint32_t r) BODY                                                           \
    API int fmi3Get##NAME(void *m, const uint32_t *r, size_t n, TYPE *v, size_t nv) {                           \
        for (size_t i = 0; i < n; i++) {                                                                        \
            TYPE *p = at_##NAME(m, r[i]);                                                                       \
            if (!p) return ERROR;                                                                               \
            v[i] = *p;                                                                                          \
        }                                                                                                       \
        return OK;                                                                                              \
    }                                                                                                           \
    API int fmi3Set##NAME(void *m, const uint32_t *r, size_t n, const TYPE *v, size_t nv) {                     \
        for (size_t i = 0; i < n; i++) {                                                                        \
            TYPE *p = at_##NAME(m, r[i]);                                                                       \
            if (!p) return ERROR;                                                                               \
            *p = v[i];                                                                                          \
        }                                                                                                       \
        return OK;                                                                                              \
    }
ACCESS(Float64, double, { return r == 1 ? &m->s.real_in : r == 2 ? &m->s.real_out : r == 4 ? &m->s.single_out
                                 : r == 20 ? &m->s.limit : NULL; })
ACCESS(Float32, float, { return r == 3 ? &m->s.single_in : NULL; })
ACCESS(Int8, int8_t, { return r == 5 ? &m->s.byte_in : r == 6 ? &m->s.byte_out : NULL; })
ACCESS(UInt32, uint32_t, { return r == 7 ? &m->s.count_in : r == 8 ? &m->s.count_out : NULL; })
ACCESS(Int64, int64_t, { return r == 9 ? &m->s.level_in : r == 10 ? &m->s.level_out : NULL; })
ACCESS(Boolean, bool, { return r == 11 ? &m->s.flag_in : r == 12 ? &m->s.flag_out : NULL; })

API int fmi3GetString(void *v, const uint32_t *r, size_t n, const char **values, size_t nv) {
    Model *m = v;
    for (size_t i = 0; i < n; i++) values[i] = r[i] == 13 ? m->s.word_in : m->s.word_out;
    return OK;
}
API int fmi3SetString(void *v, const uint32_t *r, size_t n, const char *const *values, size_t nv) {
    Model *m = v;
    for (size_t i = 0; i < n; i++) strncpy(r[i] == 13 ? m->s.word_in : m->s.word_out, values[i], 31);
    return OK;
}

API int fmi3DoStep(void *v, double time, double h, bool no_rollback, bool *event, bool *terminate, bool *early,
                   double *reached) {
    Model *m = v;
    *event = *terminate = *early = false;
    *reached = time;
    if (h > 0.25 + 1e-12) {
        m->log(m->environment, DISCARD, "step", "the step is too long");
        return DISCARD;
    }
    m->s.real_out += m->s.real_in * h;
    if (m->s.real_out > m->s.limit) {
        m->log(m->environment, ERROR, "limit", "real_out has passed its limit");
        return ERROR;
    }
    m->s.single_out = m->s.single_in;
    m->s.byte_out = -m->s.byte_in;
    m->s.count_out = m->s.count_in + 1;
    /* -53 stands for a number that no signal, a double, can bring. */
    m->s.level_out = m->s.level_in == -53 ? (INT64_C(1) << 53) + 1 : m->s.level_in;
    m->s.flag_out = !m->s.flag_in;
    strcpy(m->s.word_out, m->s.word_in);
    *reached = time + h;
    return OK;
}

API int fmi3GetFMUState(void *v, void **state) {
    if (!*state) *state = malloc(sizeof(State));
    memcpy(*state, &((Model *)v)->s, sizeof(State));
    return OK;
}
API int fmi3SetFMUState(void *v, void *state) {
    memcpy(&((Model *)v)->s, state, sizeof(State));
    return OK;
}
API int fmi3FreeFMUState(void *v, void **state) {
    free(*state);
    *state = NULL;
    return OK;
}
API int fmi3SerializedFMUStateSize(void *v, void *state, size_t *size) {
    *size = sizeof(State);
    return OK;
}
API int fmi3SerializeFMUState(void *v, void *state, uint8_t *bytes, size_t size) {
    memcpy(bytes, state, size);
    return OK;
}
API int fmi3DeserializeFMUState(void *v, const uint8_t *bytes, size_t size, void **state) {
    if (!*state) *state = malloc(sizeof(State));
    memcpy(*state, bytes, size);
    return OK;
}
