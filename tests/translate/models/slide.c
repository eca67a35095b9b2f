/* Dry friction without an event, x' = v, v' = push sin(t) - friction sign(v), beside what is smooth:
 * s' = rate (cos(t) - s). */
#include <math.h>
#define HAS_STATES
#include "defaults.h"

const ModelInfo model_info = {"slide", "{slide}", 7, 3, 0, 3, 0, 0, 0, 0};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"x", KIND_STATE, 0, TYPE_REAL, 1, 0, 1},
    {"v", KIND_STATE, 1, TYPE_REAL, 1, 0, 1},
    {"s", KIND_STATE, 2, TYPE_REAL, 1, 1, 1},
    {"push", KIND_PARAMETER, 0, TYPE_REAL, 1, 0, 1},
    {"friction", KIND_PARAMETER, 1, TYPE_REAL, 1, 0, 1},
    {"rate", KIND_PARAMETER, 2, TYPE_REAL, 1, 0, 1},
};

void model_derivatives(const ModelPoint *at, double *xdot)
{
    double v = at->x[1];
    xdot[0] = v;
    xdot[1] = at->p[0] * sin(at->time) - at->p[1] * ((v > 0) - (v < 0));
    xdot[2] = at->p[2] * (cos(at->time) - at->x[2]);
}

void model_algebraics(const ModelPoint *at, double *w)
{
    (void)at;
    (void)w;
}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    (void)w;
    (void)operand;
    xdot[0] = seed->x[1];
    xdot[1] = 0;
    xdot[2] = -at->p[2] * seed->x[2];
}
