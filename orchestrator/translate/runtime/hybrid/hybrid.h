/* What a model with events, equation blocks or constraints gives to its solver, hybrid.c.
 *
 * All that changes stands in one array z, which is the state x of stepmodel.h: values of variables and
 * derivatives, values before an event, modes (relations and steps as they are held between events), truth of
 * conditions, ticks of clocks, start values. So a saved state of the FMU holds all of it.
 */
#ifndef HYBRID_H
#define HYBRID_H

typedef struct {
    double t;
    const double *u, *p;
    double *z;
    const double *c, *rise; /* truth of the conditions, and which become true now */
    const double *tick;     /* [clocks] 1: due now */
    int initial;
    double homotopy;        /* 0: simplified, 1: actual equations */
} Hybrid;

/* One block of equations. A solved one has a function `assign` alone. */
typedef struct {
    int n;                  /* unknowns */
    int linear;
    const int *slots;       /* [n] of the unknowns in z */
    void (*assign)(const Hybrid *);
    void (*residuals)(const Hybrid *, double *r);
    void (*jacobian)(const Hybrid *, double *j); /* [n][n] by rows; NULL: by differences */
    const char *names;      /* of the unknowns, for messages */
} HybridBlock;

/* Where a sparse matrix of the states and its factors, in the same place, have entries, by rows. */
typedef struct {
    int n_entries;
    const int *order;                     /* [n_states] state of each row and column */
    const int *starts, *columns;          /* columns ascend */
    const int *diagonals;                 /* [n_states] entry on the diagonal of each row */
    const int *entries;                   /* entry for each of HybridInfo.rows */
} HybridFactors;

/* A bound is what expressions need to have a value, as subscripts within an array. */
typedef enum { ACTION_ASSERT, ACTION_WARNING, ACTION_TERMINATE, ACTION_BOUND } HybridActionKind;

typedef struct {
    int n_z;
    int n_states;
    const int *state_slots, *slope_slots; /* [n_states] */
    const double *nominals;               /* [n_states] */
    int n_blocks, n_initial_blocks;
    const HybridBlock *blocks, *initial_blocks;
    int n_modes, mode_slot;               /* first of them in z */
    const char *const *mode_names;
    int n_conditions, condition_slot;
    int n_clocks, clock_slot;             /* number of the next tick */
    const double *phases, *periods;
    int n_instants;
    const double *instants;
    int n_pre, n_pre_discrete;            /* value before an event <- value; discrete variables first */
    const int *pre_slots, *pre_of;
    int n_discretes;
    const int *discrete_slots;
    int n_started;                        /* variables with a start value, in `start_slots` */
    const int *started_slots, *start_slots;
    int n_settable;                       /* of them an importer may set: the variable, its start, the last result */
    const int *settable_slots, *settable_starts, *settable_lasts;
    int n_actions, warned_slot;
    const int *action_kinds;
    const int *action_rises;              /* 1: it counts where its condition rises alone */
    const char *const *messages;
    int n_constraints;
    int done_slot, size_slot;             /* 1 after initialisation; internal step size [s], < 0: implicit */
    int n_margins;
    const int *mode_margins;              /* [n_modes] margin of a relation; -1 of a step function */
    int use_slot, end_slot;               /* a HybridUse; time that the last step came to [s] */
    int ended_slot;                       /* 1: the model has asked for the end */
    int has_homotopy;
    int n_colours;                        /* of states, so that two of one colour share no derivative */
    const int *colours;                   /* [n_states] */
    const int *column_starts, *rows;      /* derivatives that each state is in */
    const HybridFactors *factors;         /* NULL: dense */
    int n_delays, history_slot;           /* delay operators: at most HISTORY_MOST */
    const char *const *delayed_names;
    const char *const *checked;           /* names for hybrid_contradiction */
} HybridInfo;

enum { HISTORY_MOST = 64, HISTORY_SEGMENTS = 4096, HISTORY_ROOM = 6 + 8 * HISTORY_SEGMENTS };

/* What an instance is used for: it decides when events are handled. */
typedef enum {
    USE_EARLY_RETURN = -1,                /* in steps, each of which ends with an event */
    USE_STEPS = 0,
    USE_EVENT_MODE = 1,                   /* by an importer that integrates */
    USE_CONTINUOUS_TIME = 2
} HybridUse;

extern const HybridInfo hybrid_info;

void hybrid_dependents(const Hybrid *);          /* dependent parameters and start values */
void hybrid_modes(const Hybrid *, double *m);
void hybrid_margins(const Hybrid *, double *g);  /* a mode changes where one of its margins crosses 0 */
void hybrid_conditions(const Hybrid *, const double *before, double *c, double *rise);
void hybrid_discretes(const Hybrid *);
int hybrid_reinits(const Hybrid *);              /* whether a state is set */
void hybrid_actions(const Hybrid *, double *a);  /* [actions] 1: has to be reported */
int hybrid_contradiction(const Hybrid *);        /* number from 1 of a redundant initial equation that fails; 0 */
void hybrid_constraints(const Hybrid *, double *r);
void hybrid_outputs(const Hybrid *, double *w);
void hybrid_delays(const Hybrid *, double *operands, double *lags);

/* history.c */
double hybrid_delayed(const Hybrid *, int k);
void history_begin(const Hybrid *);
int history_refused(const Hybrid *);
void history_pass(const Hybrid *);
double history_stop(const Hybrid *, double t, double stop, int *event);
int history_add(const Hybrid *, double begin, double length, const double y[5][HISTORY_MOST], int first);
int history_misses(const double y[5][HISTORY_MOST], const double *value, double x);

#endif
