/* x'' = omega^2 (u - x) with the start velocity speed*omega; energy = v^2/2 + omega^2 x^2/2. */
#define HAS_DEPENDENTS
#define HAS_STATES
#include "defaults.h"

const ModelInfo model_info = {"oscillator", "{oscillator}", 10, 2, 1, 5, 1, 0, 0, 0};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"x", KIND_STATE, 0, TYPE_REAL, 1, 1, 1},
    {"v", KIND_STATE, 1, TYPE_REAL, 0, 0, 1},
    {"u", KIND_INPUT, 0, TYPE_REAL, 1, 0, 1},
    {"omega", KIND_PARAMETER, 0, TYPE_REAL, 1, 2, 1},
    {"speed", KIND_PARAMETER, 1, TYPE_REAL, 1, 0, 1},
    {"energy", KIND_ALGEBRAIC, 0, TYPE_REAL, 0, 0, 1},
    {"der(v)", KIND_DERIVATIVE, 1, TYPE_REAL, 0, 0, 1},
    {"gear", KIND_PARAMETER, 3, TYPE_INTEGER, 1, 1, 1},
    {"on", KIND_PARAMETER, 4, TYPE_BOOLEAN, 1, 1, 1},
};

void model_dependent_parameters(double *p) { p[2] = p[0] * p[0]; }
void model_dependent_starts(const double *p, double *x) { x[1] = p[1] * p[0]; }

void model_derivatives(const ModelPoint *at, double *xdot)
{
    xdot[0] = at->x[1];
    xdot[1] = at->p[2] * (at->p[3] * at->p[4] * at->u[0] - at->x[0]);
}

void model_algebraics(const ModelPoint *at, double *w)
{
    w[0] = at->x[1] * at->x[1] / 2 + at->p[2] * at->x[0] * at->x[0] / 2;
}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    (void)operand;
    xdot[0] = seed->x[1];
    xdot[1] = at->p[2] * (at->p[3] * at->p[4] * seed->u[0] - seed->x[0]);
    w[0] = at->x[1] * seed->x[1] + at->p[2] * at->x[0] * seed->x[0];
}
