/* What a translated model gives to the FMI runtime: equations, tables, nothing else.
 *
 * A model is  x' = f(t, x, u, p, d, m),  w = g(t, x, u, p, d, m)  with
 *   x  continuous states               u  inputs          p  parameters
 *   d  values of the delay operators   m  modes: the frozen truth (0.0 or 1.0) of each relation
 *   w  algebraic variables, outputs among them.
 * All numbers are doubles in SI units; Booleans and integers are stored as doubles.
 * Every function is pure: it reads its arguments and writes its results.
 */
#ifndef MODEL_H
#define MODEL_H

typedef struct {
    double time;
    const double *x, *u, *p, *d, *m;
} ModelPoint;

typedef enum { KIND_TIME, KIND_STATE, KIND_DERIVATIVE, KIND_INPUT, KIND_PARAMETER, KIND_ALGEBRAIC } ModelKind;
typedef enum { TYPE_REAL, TYPE_INTEGER, TYPE_BOOLEAN } ModelType;

/* The value reference of a variable is its index in model_variables. */
typedef struct {
    const char *name;
    ModelKind kind;
    int index;        /* position in x, x', u, p or w */
    ModelType type;
    int settable;     /* by the importer: inputs, independent parameters, states with an own start value */
    double start;     /* of inputs, independent parameters and states; else 0 */
    double nominal;   /* of states, > 0: scales the integrator's absolute tolerance */
} ModelVariable;

typedef struct {
    const char *name;                /* model identifier */
    const char *token;               /* guid (FMI 2) or instantiationToken (FMI 3) */
    int n_variables, n_x, n_u, n_p, n_w;
    int n_d;                         /* delay operators */
    int n_m;                         /* relations, one mode each */
    int n_a;                         /* assertions */
} ModelInfo;

extern const ModelInfo model_info;
extern const ModelVariable model_variables[];
extern const int model_relation_strict[];        /* [n_m] 1: true while r > 0; 0: true while r >= 0 */
extern const char *const model_assertion_messages[]; /* [n_a] */
extern const int model_assertion_is_error[];     /* [n_a] 1: error, 0: warning */

/* Dependent parameters and states whose start depends on parameters: computed in place. */
void model_dependent_parameters(double *p);
void model_dependent_starts(const double *p, double *x);

void model_derivatives(const ModelPoint *at, double *xdot);
void model_algebraics(const ModelPoint *at, double *w);
/* Operand and delay time [s] of each delay operator; entry j reads d[k] only for k < j. */
void model_delays(const ModelPoint *at, double *operand, double *delay_time);
/* Longest delay time [s] of each operator: its delay time where that depends on parameters alone, else
 * its limit (delayMax), else INFINITY. So much history is kept; a longer delay time is an error. */
void model_delay_maxima(const double *p, double *maximum);
/* Relation i is the sign of r[i]; it may read d and the modes of other relations. */
void model_relations(const ModelPoint *at, double *r);
/* Assertion i holds while a[i] is not 0. */
void model_assertions(const ModelPoint *at, double *a);
/* Forward derivatives: `seed` holds the variation of t, x, u, p and d (its m is not read). */
void model_tangent(const ModelPoint *at, const ModelPoint *seed,
                   double *xdot, double *w, double *operand);

#endif
