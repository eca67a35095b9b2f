/* One FMU instance, seen by the FMI 2.0 and 3.0 interfaces: state, evaluation, integration.
 *
 * No file of the runtime holds mutable globals: any number of instances live in one process.
 */
#ifndef RUNTIME_H
#define RUNTIME_H

#include <stddef.h>

#include "model.h"

/* Equal in value to fmi2Status and fmi3Status. */
typedef enum { RT_OK, RT_WARNING, RT_DISCARD, RT_ERROR, RT_FATAL } RtStatus;

/* Bits, so that an interface function can name the set of phases it is legal in. */
typedef enum {
    PHASE_INSTANTIATED = 1,
    PHASE_INITIALIZATION = 2,
    PHASE_STEP = 4,
    PHASE_STEP_DISCARDED = 8,
    PHASE_TERMINATED = 16,
    PHASE_ERROR = 32
} Phase;

/* A stretch of a delay operator's operand:  sum of c[i] theta^i,  theta = (t - begin)/(end - begin). */
typedef struct {
    double begin, end;
    double c[5];
    long long piece; /* stretches of one piece follow each other smoothly */
    long long level; /* of the discontinuity that opened the piece: 0 value, 1 slope, 2 curvature, ... */
} Segment;

/* A delay operator, as far as a saved state copies it as bytes. Segments are numbered from 0 for ever. */
typedef struct {
    long long first, next;       /* numbers of the kept segments: first <= n < next */
    long long cursor;            /* where the last look-up ended; a hint, never part of a result */
    long long newest;            /* piece being written */
    long long newest_level;
    double newest_begin;
    long long piece;             /* piece being read */
    double begin, end;           /* of the piece being read; end is infinite while it is written */
    double maximum;              /* longest delay time [s] */
    double last;                 /* operand where its history ends, from the left */
    double scale;                /* largest magnitude of the operand so far */
    double lag_before;           /* delay time [s] at the previous internal step; negative: none yet */
} Delay;

/* The scalars that a saved state copies as bytes; 8-byte members only, so there is no padding. */
typedef struct {
    long long phase;
    long long started;           /* past initialisation: delay operators have a history */
    long long stop_defined;
    double start_time, stop_time;
    double time;
    double tolerance;            /* relative, per internal step */
    double step_memory;          /* internal step size the error control would take next [s] */
    double last_success;         /* [s] */
    double last_event;           /* [s] */
    long long near_events;       /* events in close succession, for the detection of chattering */
    long long slopes, slopes_before; /* input derivatives set for the coming, used in the past step */
    long long parameters_stale, modes_stale, outputs_stale, derivatives_stale;
    long long first_stage_valid; /* k[0] belongs to the present time and discrete state */
} Scalars;

typedef struct Runtime {
    Scalars s;

    double *saved;               /* one block behind the following arrays, copied into saved states */
    size_t n_saved;
    double *x, *u, *p;
    double *u1, *u2;             /* first and second time derivative of the inputs in this step */
    double *u_before;            /* inputs at the end of the past step */
    double *m, *m_done;          /* modes now, and at the end of the past step */
    double *d;                   /* values of the delay operators */
    double *k1;                  /* x' at the present time */
    double *operand, *lag;       /* operand and delay time at the present time */
    double *warned;              /* [n_a] 1 once the warning has been logged */

    double *scratch;             /* one block behind the following arrays */
    double *k[7];                /* stages; k[0] is k1 */
    double *dense[5];            /* coefficients of the dense output */
    double *x_new, *x_stage, *u_stage, *u_now, *d_stage, *operand_stage, *lag_stage;
    double *samples;             /* [n_d][5] operand at 0, 1/4, 1/2, 3/4, 1 of the internal step */
    double *guess;               /* [n_d][5] the operand's polynomial over the internal step */
    double *relations, *truth;   /* [n_m] */
    double *assertions;          /* [n_a] */
    double *w, *xdot;
    double *nominal;             /* [n_x] */
    double *t_x, *t_u, *t_p, *t_d, *t_xdot, *t_w, *t_operand; /* forward derivatives */

    Delay *delays;               /* [n_d] */
    Segment **rings;             /* [n_d] segment n of operator j is rings[j][n modulo capacity] */
    long long *capacities;       /* [n_d] powers of two */

    double step_start, step_size; /* of the communication step [s] */
    double t0, h;                /* of the internal step being tried [s] */
    int stepping;                /* an internal step is being tried */
    int overlapped;              /* it read an operand within itself */
    long long crossed_level;     /* smallest level of the discontinuities a delay operator moved across */
    long long *crossed;          /* [n_d] 1: this operator moved */
    long long *levels;           /* [n_d] */

    RtStatus trouble;            /* what went wrong last, for the message */
    char trouble_text[512];

    char *instance_name;
    int logging, n_categories;
    unsigned categories;         /* bits of the categories chosen by SetDebugLogging */
    void (*emit)(struct Runtime *, RtStatus, const char *category, const char *message);
    void *environment;
    void *logger;                /* what emit needs, an interface's own */
    void *functions;
} Runtime;

/* component.c: life cycle, variables, evaluation at the present time */
/* NULL, with the reason in `why`, if the token is not that of this binary or there is no memory. `resources`
 * is where the FMU's files are, as the importer tells it: a file URI (FMI 2) or a path (FMI 3). */
Runtime *rt_new(const char *instance_name, const char *token, const char *resources, char *why, size_t room);
void rt_free(Runtime *);
RtStatus rt_reset(Runtime *);
RtStatus rt_terminate(Runtime *);
RtStatus rt_enter_initialization(Runtime *);
RtStatus rt_exit_initialization(Runtime *);
RtStatus rt_get(Runtime *, unsigned reference, ModelType, double *value);
RtStatus rt_set(Runtime *, unsigned reference, ModelType, double value);
RtStatus rt_set_input_derivative(Runtime *, unsigned reference, int order, double value);
RtStatus rt_set_up(Runtime *, int tolerance_defined, double tolerance, double start_time, int stop_defined,
                   double stop_time);
const ModelVariable *rt_variable(Runtime *, const char *call, unsigned reference);

/* evaluate.c */
const double *rt_inputs(Runtime *, double time);
int rt_field(Runtime *, double time, const double *x, double *xdot, double *operand, double *lag);
int rt_settle(Runtime *);
RtStatus rt_refresh_modes(Runtime *);
RtStatus rt_refresh_outputs(Runtime *);
RtStatus rt_refresh_derivatives(Runtime *);
RtStatus rt_check_assertions(Runtime *);
const char *rt_state_name(int index);

/* delay.c; how a delay operator finds the piece of the operand's history it reads */
typedef enum {
    READ_SELECT, /* the piece at its place, from the right: at communication points and events */
    READ_FROZEN  /* the piece selected last, so that an internal step sees a smooth function */
} ReadMode;
int delay_values(Runtime *, ModelPoint *at, double *d, double *operand, double *lag, ReadMode);
int delay_crossed(const Runtime *, double time, const double *lag);
double delay_slope(Runtime *, int j, double time);
int delay_start(Runtime *);
void delay_open_pieces(Runtime *, int inputs, int switched);
int delay_append(Runtime *, double begin, double end);
void delay_polynomial(const double *samples, double *c);

/* integrate.c */
typedef enum {
    STEP_ACCEPTED,
    STEP_EVENT,    /* repeat it so that it ends where the discrete state first disagrees */
    STEP_SHORTEN,  /* repeat it for the sake of the operands' histories */
    STEP_REJECTED  /* repeat it shorter; the trouble is noted */
} Verdict;
Verdict rt_attempt(Runtime *, double end, double *factor, int *event);
double rt_event_tolerance(const Runtime *);

/* step.c */
RtStatus rt_do_step(Runtime *, double point, double size);

/* derivative.c */
RtStatus rt_directional(Runtime *, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                        size_t n_knowns, const double *seed, double *sensitivity);
RtStatus rt_adjoint(Runtime *, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                    size_t n_knowns, const double *seed, double *sensitivity);

/* state.c; a saved state is a block of bytes that starts with its size */
RtStatus rt_save(Runtime *, void **state);
RtStatus rt_restore(Runtime *, const void *state);
size_t rt_state_size(const void *state);
void rt_state_free(void **state);
RtStatus rt_state_write(Runtime *, const void *state, unsigned char *bytes, size_t size);
RtStatus rt_state_read(Runtime *, const unsigned char *bytes, size_t size, void **state);

/* log.c */
void rt_log(Runtime *, RtStatus, const char *format, ...);
void rt_log_event(Runtime *, const char *format, ...);
int rt_fail(Runtime *, RtStatus, const char *format, ...); /* notes the trouble; always returns 1 */
RtStatus rt_report(Runtime *, const char *call);           /* logs the noted trouble, returns its status */
RtStatus rt_set_logging(Runtime *, int on, size_t n, const char *const *categories);
int rt_legal(Runtime *, const char *call, int phases);
int rt_not_null(Runtime *, const char *call, const char *argument, const void *value);

#endif
