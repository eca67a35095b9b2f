/* A system of FMUs behind the interface of one: loaded from files, stepped by a master.
 *
 * It stands in for component.c and what that needs. What the system consists of is read from
 * resources/system.txt; reading.c tells its form. As everywhere in the runtime there are no mutable globals.
 */
#ifndef SYSTEM_H
#define SYSTEM_H

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"
#include "runtime.h"

/* Types of the inner FMUs' variables. */
typedef enum { V_F64, V_F32, V_I8, V_U8, V_I16, V_U16, V_I32, V_U32, V_I64, V_U64, V_BOOL, V_TEXT, N_TYPES } Type;

typedef void (*Symbol)(void);

/* One of the functions of every version. */
typedef enum {
    CALL_INSTANTIATE, CALL_FREE, CALL_SET_UP, CALL_ENTER, CALL_EXIT, CALL_STEP, CALL_TERMINATE, CALL_RESET, CALL_SAVE, CALL_RESTORE, CALL_FORGET, CALL_SIZE, CALL_WRITE, CALL_READ,
    N_FUNCTIONS
} Function;

typedef struct {
    int version;                 /* of FMI, 2 or 3 */
    const char *identifier, *folder, *token;
    int can_save, can_serialise;
    void *handle;
    Symbol functions[N_FUNCTIONS], get[N_TYPES], set[N_TYPES];
} Library;

/* Values that one call moves between an inner FMU and memory. */
typedef struct {
    int instance, getting, n_references, n_values;
    Type type;
    unsigned *references;
    int *places;                 /* [n_values] in the inputs or the signals; negative: kept as it is */
    void *buffer;
} Block;

/* A variable of an inner FMU, or an element of one. */
typedef struct {
    int instance, element, elements;
    Type type;
    unsigned reference;
} Place;

typedef struct {
    Place at;
    int n;                       /* values, or characters of a text */
    double *numbers;
    const char *text;
} Start;

/* input = gain * source + offset; a negative source -1 - k is input k of the whole. */
typedef struct {
    int source;
    double gain, offset;
} Feed;

typedef struct {
    int kind, n_options, n_reads, n_memory, first_memory;
    double *options;
    int *reads;
} Link;

/* A signal made of others: a sum, through effects in turn. */
typedef struct {
    int place, n_legs, n_links, first_leg, first_link;
} Path;

/* What happens at initialisation, in order. */
typedef enum { ACTION_READ, ACTION_GIVE, ACTION_LOOP } ActionKind;
typedef struct {
    ActionKind kind;
    Place at;
    int place;                   /* of the signal: where it goes, or where it comes from */
    int path;                    /* to evaluate first; -1: none */
    double gain, offset;         /* of what is given; the gain of what is read is its nominal value */
    int n_reads, n_gives;        /* of a loop, which follow it */
} Action;

typedef enum { VARIABLE_TIME, VARIABLE_SIGNAL, VARIABLE_INPUT, VARIABLE_PARAMETER } VariableKind;
typedef struct {
    VariableKind kind;
    ModelType type;
    int place;                   /* of the signal, or number of the input */
    int tunable;
    Place at;                    /* of inputs and parameters */
    const char *name;
} Variable;

struct Container;

typedef struct {
    struct Container *owner;
    const char *name;
    char *full_name;             /* with the name of the whole before it */
    Library *library;
    void *component;
    int every, parts;            /* its own step: so many of the system's, or such a part of one */
    int converts, first_input, n_inputs;
    int first_set, n_sets, first_get, n_gets, first_after, n_after;
    fmi2CallbackFunctions callbacks;
} Inner;

#define LIST(type, name) \
    type *name;          \
    int n_##name

typedef struct Container {
    Runtime rt;                  /* first, so that a pointer to one is a pointer to the other */
    char *text;                  /* of resources/system.txt, to which names point */
    char *resources;             /* path, without a separator at its end */
    const char *token, *name;
    long long begin, stride, denominator;
    double step_size;            /* [s] */
    int late;                    /* inputs are fed right before each step (Gauss-Seidel) */
    int n_signals, n_ports, n_inputs, n_externals, n_memory;
    LIST(Library, libraries);
    LIST(Inner, inner);
    LIST(Start, starts);
    LIST(int, order);
    LIST(Block, blocks);
    LIST(Feed, feeds);
    LIST(Path, paths);
    LIST(Feed, legs);
    LIST(Link, links);
    LIST(int, after);
    LIST(Action, actions);
    LIST(Variable, variables);
    /* What a saved state holds besides the scalars; within rt.saved. */
    double *index;               /* steps that are taken */
    double *stale;               /* 1: initial values are yet to be passed on */
    double *signals, *inputs, *externals, *begun, *memory;
    long long kept;              /* saved states that are not freed */
    char early[512];             /* what inner FMUs logged before there was somebody to tell */
} Container;

/* reading.c; 0, or 1 with a message */
int system_read(Container *, char *why, size_t room);
void system_forget(Container *);

/* library.c */
char *file_path(const char *location);
char *file_content(const char *path);
int library_load(Library *, const char *resources, char *why, size_t room);
void library_unload(Library *);

/* inner.c */
int inner_make(Container *, Inner *, char *why, size_t room);
void inner_free(Inner *);
RtStatus inner_call(Inner *, Function);
RtStatus inner_enter(Inner *, double start_time, int stop_defined, double stop_time);
RtStatus inner_step(Inner *, double time, double size);
RtStatus inner_move(Container *, const Block *);
RtStatus inner_get(Container *, const Place *, double *value);
RtStatus inner_set(Container *, const Place *, double value);
RtStatus inner_start(Container *, const Start *);
RtStatus inner_state(Inner *, Function, void **state);
RtStatus inner_state_size(Inner *, void *state, size_t *size);
RtStatus inner_state_write(Inner *, void *state, unsigned char *bytes, size_t size);
RtStatus inner_state_read(Inner *, const unsigned char *bytes, size_t size, void **state);
void *buffer_for(Type, int n);
int buffer_put(void *buffer, Type, int version, int n, double value);
double buffer_value(const void *buffer, Type, int version, int n);

/* effects.c */
double effect_value(const Link *, double time, const double *x, double *memory, int commit);

/* coupling.c */
RtStatus pass_initial_values(Container *);
RtStatus read_signals(Container *);
RtStatus accept_signals(Container *, double time);
double time_at(const Container *, long long index);
RtStatus take_step(Container *);

#endif
