/* A delay time that grows from zero: x' = -delay(x, time/2), so x'(t) = -x(t/2), x(0) = 1. */
#include <math.h>
#define HAS_STATES
#define HAS_DELAYS
#include "defaults.h"

const ModelInfo model_info = {"pantograph", "{pantograph}", 2, 1, 0, 0, 0, 1, 0, 0};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"x", KIND_STATE, 0, TYPE_REAL, 1, 1, 1},
};

void model_derivatives(const ModelPoint *at, double *xdot) { xdot[0] = -at->d[0]; }
void model_algebraics(const ModelPoint *at, double *w) { (void)at; (void)w; }

void model_delays(const ModelPoint *at, double *operand, double *delay_time)
{
    operand[0] = at->x[0];
    delay_time[0] = at->time / 2;
}

void model_delay_maxima(const double *p, double *maximum)
{
    (void)p;
    maximum[0] = INFINITY;
}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    (void)at; (void)w;
    xdot[0] = -seed->d[0];
    operand[0] = seed->x[0];
}
