/* A mass flies against a spring at x = gap: x'' = -k (x - gap)/m + g while x > gap.
 * Warning beyond `soft`, error beyond `hard`. */
#define HAS_STATES
#define HAS_RELATIONS
#define HAS_ASSERTIONS
#include "defaults.h"

const ModelInfo model_info = {"contact", "{contact}", 9, 2, 0, 5, 1, 0, 1, 2};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"x", KIND_STATE, 0, TYPE_REAL, 1, 0, 1},
    {"v", KIND_STATE, 1, TYPE_REAL, 1, 1, 1},
    {"gap", KIND_PARAMETER, 0, TYPE_REAL, 1, 0.3, 1},
    {"k", KIND_PARAMETER, 1, TYPE_REAL, 1, 100, 1},
    {"force", KIND_ALGEBRAIC, 0, TYPE_REAL, 0, 0, 1},
    {"soft", KIND_PARAMETER, 2, TYPE_REAL, 1, 1e9, 1},
    {"hard", KIND_PARAMETER, 3, TYPE_REAL, 1, 1e9, 1},
    {"drag", KIND_PARAMETER, 4, TYPE_REAL, 1, 0, 1},
};

static double force(const ModelPoint *at)
{
    return at->m[0] != 0 ? -at->p[1] * (at->x[0] - at->p[0]) : 0;
}

void model_derivatives(const ModelPoint *at, double *xdot)
{
    xdot[0] = at->x[1];
    xdot[1] = force(at) - at->p[4];
}

void model_algebraics(const ModelPoint *at, double *w) { w[0] = force(at); }

const int model_relation_strict[] = {1};
void model_relations(const ModelPoint *at, double *r) { r[0] = at->x[0] - at->p[0]; }

const char *const model_assertion_messages[] = {"x is beyond soft (100 % used)", "x is beyond hard"};
const int model_assertion_is_error[] = {0, 1};
void model_assertions(const ModelPoint *at, double *a)
{
    a[0] = at->x[0] <= at->p[2];
    a[1] = at->x[0] <= at->p[3];
}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    (void)operand;
    w[0] = at->m[0] != 0 ? -at->p[1] * seed->x[0] : 0;
    xdot[0] = seed->x[1];
    xdot[1] = w[0];
}
