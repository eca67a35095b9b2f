/* Delay time that depends on the state (Feldstein, Neves, SIAM J. Numer. Anal. 21, 1984):
 * y'(t) = y(y(t) - sqrt(2) + 1) / (2 sqrt(t)), t >= 1, y = 1 before.
 * y = sqrt(t) up to t = 2, then t/4 + 1/2 + (1 - sqrt(2)/2) sqrt(t) up to 5.0294. */
#include <math.h>
#define HAS_STATES
#define HAS_DELAYS
#include "defaults.h"

const ModelInfo model_info = {"statedelay", "{statedelay}", 3, 1, 0, 0, 1, 1, 0, 0};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"y", KIND_STATE, 0, TYPE_REAL, 1, 1, 1},
    {"d", KIND_ALGEBRAIC, 0, TYPE_REAL, 0, 0, 1},
};

void model_derivatives(const ModelPoint *at, double *xdot) { xdot[0] = at->d[0] / (2 * sqrt(at->time)); }
void model_algebraics(const ModelPoint *at, double *w) { w[0] = at->d[0]; }

void model_delays(const ModelPoint *at, double *operand, double *delay_time)
{
    operand[0] = at->x[0];
    delay_time[0] = at->time - (at->x[0] - sqrt(2) + 1);
}

void model_delay_maxima(const double *p, double *maximum)
{
    (void)p;
    maximum[0] = INFINITY;
}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    xdot[0] = seed->d[0] / (2 * sqrt(at->time));
    w[0] = seed->d[0];
    operand[0] = seed->x[0];
}
