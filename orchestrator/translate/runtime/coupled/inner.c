/* Calls to the inner FMUs, alike for FMI 2.0 and 3.0. */
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "system.h"

typedef int (*Plain)(void *);
typedef int (*Step2)(void *, double, double, int);
typedef int (*SetUp2)(void *, int, double, double, int, double);
typedef int (*Enter3)(void *, bool, double, double, bool, double);
typedef int (*Step3)(void *, double, double, bool, bool *, bool *, bool *, double *);
typedef int (*Move2)(void *, const unsigned *, size_t, void *);
typedef int (*Move3)(void *, const unsigned *, size_t, void *, size_t);
typedef int (*Handle)(void *, void *);
typedef int (*Size)(void *, void *, size_t *);
typedef int (*Write)(void *, void *, unsigned char *, size_t);
typedef int (*Read)(void *, const unsigned char *, size_t, void **);

static const char *const STATUS[] = {"ok", "warning", "discard", "error", "fatal", "pending"};

/* Messages. */

static void hear(Inner *inner, int status, const char *text)
{
    Container *c = inner->owner;
    if (!c->rt.emit) { /* while instances are made there is nobody to tell yet */
        size_t used = strlen(c->early);
        snprintf(c->early + used, sizeof c->early - used, "\n  %s: %s", inner->name, text);
    } else if (status == RT_OK) {
        rt_log_event(&c->rt, "%s: %s", inner->name, text);
    } else {
        rt_log(&c->rt, (RtStatus)(status > RT_FATAL ? RT_ERROR : status), "%s: %s", inner->name, text);
    }
}

static void hear2(void *environment, const char *name, fmi2Status status, const char *category,
                  const char *message, ...)
{
    char text[700];
    va_list arguments;
    (void)name;
    (void)category;
    va_start(arguments, message);
    vsnprintf(text, sizeof text, message, arguments);
    va_end(arguments);
    hear(environment, status, text);
}

static void hear3(void *environment, fmi3Status status, const char *category, const char *message)
{
    (void)category;
    hear(environment, status, message);
}

/* A call that did not go well is the trouble of the whole. */
static RtStatus judged(Inner *inner, int status, const char *call)
{
    if (status <= RT_WARNING) return (RtStatus)status;
    rt_fail(&inner->owner->rt, RT_ERROR, "%s: %s returned %s", inner->name, call,
            status <= 5 ? STATUS[status] : "an illegal status");
    return RT_ERROR;
}

static int absent(Inner *inner, Symbol function, const char *call)
{
    return function ? 0 : rt_fail(&inner->owner->rt, RT_ERROR, "%s: its library has no function %s",
                                  inner->name, call);
}

/* Life. */

static char *joined(const char *a, const char *b, const char *c)
{
    char *text = malloc(strlen(a) + strlen(b) + strlen(c) + 1);
    if (text) strcat(strcat(strcpy(text, a), b), c);
    return text;
}

/* A file URI of a path, which has to be absolute. */
static char *uri_of(const char *path)
{
    static const char plain[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-._~/:";
    char *uri = malloc(3 * strlen(path) + 16), *to = uri;
    if (!uri) return NULL;
    to += sprintf(to, path[0] == '/' ? "file://" : "file:///");
    for (; *path; path++) {
        if (*path == '\\') *to++ = '/';
        else if (strchr(plain, *path)) *to++ = *path;
        else to += sprintf(to, "%%%02X", (unsigned)(unsigned char)*path);
    }
    *to = 0;
    return uri;
}

/* 0, or 1 with a message. */
int inner_make(Container *c, Inner *inner, char *why, size_t room)
{
    Library *library = inner->library;
    char *place = joined(c->resources, "/", library->folder);
    char *folder = place ? joined(place, "/resources", library->version == 2 ? "" : "/") : NULL;
    char *location = folder ? (library->version == 2 ? uri_of(folder) : joined(folder, "", "")) : NULL;
    inner->owner = c;
    inner->full_name = joined(c->rt.instance_name, ".", inner->name);
    if (location && inner->full_name) {
        Symbol function = library->functions[CALL_INSTANTIATE];
        c->early[0] = 0;
        if (library->version == 2) {
            fmi2CallbackFunctions callbacks = {hear2, calloc, free, NULL, inner};
            memcpy(&inner->callbacks, &callbacks, sizeof callbacks);
            inner->component = ((fmi2InstantiateTYPE *)function)(
                inner->full_name, fmi2CoSimulation, library->token, location, &inner->callbacks, 0, 0);
        } else {
            inner->component = ((fmi3InstantiateCoSimulationTYPE *)function)(
                inner->full_name, library->token, location, false, false, false, false, NULL, 0, inner, hear3,
                NULL);
        }
    }
    free(place);
    free(folder);
    free(location);
    if (inner->component) return 0;
    snprintf(why, room, "instance %s could not be made%s", inner->name, c->early);
    return 1;
}

void inner_free(Inner *inner)
{
    if (inner->component) ((void (*)(void *))inner->library->functions[CALL_FREE])(inner->component);
    inner->component = NULL;
    free(inner->full_name);
    inner->full_name = NULL;
}

RtStatus inner_call(Inner *inner, Function function)
{
    static const char *const names[N_FUNCTIONS] = {
        [CALL_EXIT] = "ExitInitializationMode", [CALL_TERMINATE] = "Terminate", [CALL_RESET] = "Reset"};
    Symbol symbol = inner->library->functions[function];
    if (function == CALL_TERMINATE && !symbol) return RT_OK; /* some have nothing to end */
    if (absent(inner, symbol, names[function])) return RT_ERROR;
    return judged(inner, ((Plain)symbol)(inner->component), names[function]);
}

RtStatus inner_enter(Inner *inner, double start_time, int stop_defined, double stop_time)
{
    Symbol *functions = inner->library->functions;
    RtStatus status;
    if (!stop_defined) stop_time = 0;
    if (inner->library->version == 3)
        return judged(inner,
                      ((Enter3)functions[CALL_ENTER])(inner->component, false, 0, start_time, stop_defined != 0,
                                                 stop_time),
                      "EnterInitializationMode");
    status = judged(inner, ((SetUp2)functions[CALL_SET_UP])(inner->component, 0, 0, start_time, stop_defined, stop_time),
                    "SetupExperiment");
    if (status > RT_WARNING) return status;
    return judged(inner, ((Plain)functions[CALL_ENTER])(inner->component), "EnterInitializationMode");
}

RtStatus inner_step(Inner *inner, double time, double size)
{
    Symbol function = inner->library->functions[CALL_STEP];
    bool event = false, terminate = false, early = false;
    double reached = time + size;
    int free_to_forget = inner->owner->kept == 0, status;
    if (inner->library->version == 2)
        status = ((Step2)function)(inner->component, time, size, free_to_forget);
    else
        status = ((Step3)function)(inner->component, time, size, free_to_forget, &event, &terminate, &early,
                                   &reached);
    if (status == RT_DISCARD)
        rt_fail(&inner->owner->rt, RT_ERROR, "%s refused the step from %.17g s by %.9g s, or asks to end",
                inner->name, time, size);
    else if (terminate)
        rt_fail(&inner->owner->rt, RT_ERROR, "%s asks to end the simulation at %.9g s", inner->name, time);
    else if (early && reached < time + (1.0 - 1e-9) * size)
        rt_fail(&inner->owner->rt, RT_ERROR, "%s returned early, at %.17g s, from the step from %.17g s by %.9g s",
                inner->name, reached, time, size);
    else
        return judged(inner, status, "DoStep");
    return RT_ERROR;
}

/* Values. A Boolean of FMI 2 is an int, one of FMI 3 a bool. */

void *buffer_for(Type type, int n)
{
    (void)type;
    return calloc((size_t)(n ? n : 1), 8);
}

#define EACH_WHOLE(DO)                                                                              \
    DO(V_I8, int8_t) DO(V_U8, uint8_t) DO(V_I16, int16_t) DO(V_U16, uint16_t) DO(V_I32, int32_t) DO(V_U32, uint32_t) \
    DO(V_I64, int64_t) DO(V_U64, uint64_t)

/* 0, or 1 if the type does not hold the value. */
int buffer_put(void *buffer, Type type, int version, int n, double value)
{
    double rounded = nearbyint(value);
    uint64_t bits;
    switch (type) {
    case V_F64: ((double *)buffer)[n] = value; return 0;
    case V_F32: ((float *)buffer)[n] = (float)value; return 0;
    default: break;
    }
    if (!isfinite(value)) return 1;
    if (rounded >= -9223372036854775808.0 && rounded < 9223372036854775808.0)
        bits = (uint64_t)(int64_t)rounded;
    else
        bits = rounded > 0 && rounded < 18446744073709551616.0 ? (uint64_t)rounded : 0;
    switch (type) {
#define PUT(code, ctype) \
    case code: ((ctype *)buffer)[n] = (ctype)bits; return (double)(ctype)bits != rounded;
        EACH_WHOLE(PUT)
    case V_BOOL:
        if (version == 2) ((int *)buffer)[n] = rounded != 0;
        else ((bool *)buffer)[n] = rounded != 0;
        return 0;
    default: return 1;
    }
}

double buffer_value(const void *buffer, Type type, int version, int n)
{
    switch (type) {
    case V_F64: return ((const double *)buffer)[n];
    case V_F32: return ((const float *)buffer)[n];
#define VALUE(code, ctype) \
    case code: return (double)((const ctype *)buffer)[n];
        EACH_WHOLE(VALUE)
    case V_BOOL:
        if (version == 2) return ((const int *)buffer)[n] != 0;
        return ((const bool *)buffer)[n] ? 1.0 : 0.0;
    default: return NAN;
    }
}

static RtStatus move(Inner *inner, Type type, int getting, const unsigned *references, int n_references,
                     void *buffer, int n_values)
{
    Symbol function = (getting ? inner->library->get : inner->library->set)[type];
    const char *call = getting ? "Get" : "Set";
    int status;
    if (absent(inner, function, call)) return RT_ERROR;
    if (inner->library->version == 2)
        status = ((Move2)function)(inner->component, references, (size_t)n_references, buffer);
    else
        status = ((Move3)function)(inner->component, references, (size_t)n_references, buffer, (size_t)n_values);
    return judged(inner, status, call);
}

/* Inputs to the FMU, or the FMU's outputs to the signals. */
RtStatus inner_move(Container *c, const Block *block)
{
    Inner *inner = &c->inner[block->instance];
    int version = inner->library->version;
    RtStatus status;
    if (!block->getting)
        for (int i = 0; i < block->n_values; i++)
            if (block->places[i] >= 0 &&
                buffer_put(block->buffer, block->type, version, i, c->inputs[block->places[i]])) {
                rt_fail(&c->rt, RT_ERROR, "%s: %g is no value for an input", inner->name,
                        c->inputs[block->places[i]]);
                return RT_ERROR;
            }
    status = move(inner, block->type, block->getting, block->references, block->n_references, block->buffer,
                  block->n_values);
    if (block->getting && status <= RT_WARNING)
        for (int i = 0; i < block->n_values; i++)
            if (block->places[i] >= 0)
                c->signals[block->places[i]] = buffer_value(block->buffer, block->type, version, i);
    return status;
}

/* One value: of a variable, or of an element of an array, which is moved whole. */
static RtStatus one(Container *c, const Place *at, int getting, double *value)
{
    Inner *inner = &c->inner[at->instance];
    int version = inner->library->version;
    uint64_t few[8] = {0};
    void *buffer = at->elements <= 8 ? few : buffer_for(at->type, at->elements);
    RtStatus status = RT_OK;
    if (!buffer) {
        rt_fail(&c->rt, RT_ERROR, "no memory");
        return RT_ERROR;
    }
    if (getting || at->elements > 1)
        status = move(inner, at->type, 1, &at->reference, 1, buffer, at->elements);
    if (getting && status <= RT_WARNING) *value = buffer_value(buffer, at->type, version, at->element);
    if (!getting && status <= RT_WARNING) {
        if (buffer_put(buffer, at->type, version, at->element, *value)) {
            rt_fail(&c->rt, RT_ERROR, "%s: %g is no value for an input", inner->name, *value);
            status = RT_ERROR;
        } else {
            status = move(inner, at->type, 0, &at->reference, 1, buffer, at->elements);
        }
    }
    if (buffer != few) free(buffer);
    return status;
}

RtStatus inner_get(Container *c, const Place *at, double *value)
{
    return one(c, at, 1, value);
}

RtStatus inner_set(Container *c, const Place *at, double value)
{
    return one(c, at, 0, &value);
}

/* A start value: of a variable, of a whole array, or a text. */
RtStatus inner_start(Container *c, const Start *start)
{
    Inner *inner = &c->inner[start->at.instance];
    void *buffer;
    RtStatus status;
    if (start->at.type == V_TEXT)
        return move(inner, V_TEXT, 0, &start->at.reference, 1, (void *)&start->text, 1);
    buffer = buffer_for(start->at.type, start->n);
    for (int i = 0; buffer && i < start->n; i++)
        buffer_put(buffer, start->at.type, inner->library->version, i, start->numbers[i]);
    if (!buffer) {
        rt_fail(&c->rt, RT_ERROR, "no memory");
        return RT_ERROR;
    }
    status = move(inner, start->at.type, 0, &start->at.reference, 1, buffer, start->n);
    free(buffer);
    return status;
}

/* States. */

/* CALL_SAVE and CALL_FORGET take the address of a state, CALL_RESTORE the state itself. */
RtStatus inner_state(Inner *inner, Function function, void **state)
{
    static const char *const names[N_FUNCTIONS] = {
        [CALL_SAVE] = "GetFMUState", [CALL_RESTORE] = "SetFMUState", [CALL_FORGET] = "FreeFMUState"};
    Handle call = (Handle)inner->library->functions[function];
    return judged(inner, call(inner->component, function == CALL_RESTORE ? *state : (void *)state), names[function]);
}

RtStatus inner_state_size(Inner *inner, void *state, size_t *size)
{
    return judged(inner, ((Size)inner->library->functions[CALL_SIZE])(inner->component, state, size),
                  "SerializedFMUStateSize");
}

RtStatus inner_state_write(Inner *inner, void *state, unsigned char *bytes, size_t size)
{
    return judged(inner, ((Write)inner->library->functions[CALL_WRITE])(inner->component, state, bytes, size),
                  "SerializeFMUState");
}

RtStatus inner_state_read(Inner *inner, const unsigned char *bytes, size_t size, void **state)
{
    return judged(inner, ((Read)inner->library->functions[CALL_READ])(inner->component, bytes, size, state),
                  "DeserializeFMUState");
}
