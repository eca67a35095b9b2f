/* What goes wrong when asked to: x' = escape x^2 - slide (x > 0 ? 1 : -1), y = delay(x, lag),
 * and relations 2 and 3, each true while the other is not, when `flip` is 1. */
#include <math.h>
#define HAS_STATES
#define HAS_DELAYS
#define HAS_RELATIONS
#include "defaults.h"

const ModelInfo model_info = {"trouble", "{trouble}", 8, 1, 2, 2, 2, 1, 2, 0};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"x", KIND_STATE, 0, TYPE_REAL, 1, 1, 1},
    {"lag", KIND_INPUT, 0, TYPE_REAL, 1, 0, 1},
    {"escape", KIND_PARAMETER, 0, TYPE_REAL, 1, 0, 1},
    {"slide", KIND_PARAMETER, 1, TYPE_REAL, 1, 0, 1},
    {"y", KIND_ALGEBRAIC, 0, TYPE_REAL, 0, 0, 1},
    {"flip", KIND_INPUT, 1, TYPE_REAL, 1, 0, 1},
    {"root", KIND_ALGEBRAIC, 1, TYPE_REAL, 0, 0, 1},
};

void model_derivatives(const ModelPoint *at, double *xdot)
{
    xdot[0] = at->p[0] * at->x[0] * at->x[0] - at->p[1] * (at->m[0] != 0 ? 1 : -1);
}

void model_algebraics(const ModelPoint *at, double *w)
{
    w[0] = at->d[0];
    w[1] = sqrt(at->x[0]);
}

void model_delays(const ModelPoint *at, double *operand, double *delay_time)
{
    operand[0] = at->x[0];
    delay_time[0] = at->u[0];
}

void model_delay_maxima(const double *p, double *maximum)
{
    (void)p;
    maximum[0] = 2;
}

const int model_relation_strict[] = {1, 1};
void model_relations(const ModelPoint *at, double *r)
{
    r[0] = at->x[0];
    /* True exactly while its own mode is not. */
    r[1] = at->u[1] != 0 ? 0.5 - at->m[1] : -1;
}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    xdot[0] = 2 * at->p[0] * at->x[0] * seed->x[0];
    w[0] = seed->d[0];
    w[1] = seed->x[0] / (2 * sqrt(at->x[0]));
    operand[0] = seed->x[0];
}
