/* Two delay lines in a row, the second of a varying delay time, and the integral of the first:
 * y1 = delay(u, tau), y2 = delay(2 y1 + time, lag), q' = y1. */
#include <math.h>
#define HAS_STATES
#define HAS_DELAYS
#include "defaults.h"

const ModelInfo model_info = {"lines", "{lines}", 7, 1, 2, 1, 2, 2, 0, 0};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"u", KIND_INPUT, 0, TYPE_REAL, 1, 0, 1},
    {"lag", KIND_INPUT, 1, TYPE_REAL, 1, 0, 1},
    {"tau", KIND_PARAMETER, 0, TYPE_REAL, 1, 0.1, 1},
    {"y1", KIND_ALGEBRAIC, 0, TYPE_REAL, 0, 0, 1},
    {"y2", KIND_ALGEBRAIC, 1, TYPE_REAL, 0, 0, 1},
    {"q", KIND_STATE, 0, TYPE_REAL, 1, 0, 1},
};

void model_derivatives(const ModelPoint *at, double *xdot) { xdot[0] = at->d[0]; }

void model_algebraics(const ModelPoint *at, double *w)
{
    w[0] = at->d[0];
    w[1] = at->d[1];
}

void model_delays(const ModelPoint *at, double *operand, double *delay_time)
{
    operand[0] = at->u[0];
    delay_time[0] = at->p[0];
    operand[1] = 2 * at->d[0] + at->time;
    delay_time[1] = at->u[1];
}

void model_delay_maxima(const double *p, double *maximum)
{
    maximum[0] = p[0];
    maximum[1] = 0.5;
}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    (void)at;
    xdot[0] = seed->d[0];
    w[0] = seed->d[0];
    w[1] = seed->d[1];
    operand[0] = seed->u[0];
    operand[1] = 2 * seed->d[0] + seed->time;
}
