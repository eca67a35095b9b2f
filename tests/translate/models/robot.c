/* Second order behind a delay: position' = velocity,
 * velocity' = omega^2 (delay(command, tau) - position) - 2 xi omega velocity. */
#define HAS_STATES
#define HAS_DELAYS
#include "defaults.h"

const ModelInfo model_info = {"robot", "{robot}", 7, 2, 1, 3, 0, 1, 0, 0};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"command", KIND_INPUT, 0, TYPE_REAL, 1, 0, 1},
    {"position", KIND_STATE, 0, TYPE_REAL, 1, 0, 1},
    {"velocity", KIND_STATE, 1, TYPE_REAL, 1, 0, 1},
    {"omega", KIND_PARAMETER, 0, TYPE_REAL, 1, 471.23889803846896, 1},
    {"xi", KIND_PARAMETER, 1, TYPE_REAL, 1, 0.8, 1},
    {"tau", KIND_PARAMETER, 2, TYPE_REAL, 1, 0.002, 1},
};

void model_derivatives(const ModelPoint *at, double *xdot)
{
    double omega = at->p[0];
    xdot[0] = at->x[1];
    xdot[1] = omega * omega * (at->d[0] - at->x[0]) - 2 * at->p[1] * omega * at->x[1];
}

void model_algebraics(const ModelPoint *at, double *w) { (void)at; (void)w; }

void model_delays(const ModelPoint *at, double *operand, double *delay_time)
{
    operand[0] = at->u[0];
    delay_time[0] = at->p[2];
}

void model_delay_maxima(const double *p, double *maximum) { maximum[0] = p[2]; }

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    double omega = at->p[0];
    (void)w;
    xdot[0] = seed->x[1];
    xdot[1] = omega * omega * (seed->d[0] - seed->x[0]) - 2 * at->p[1] * omega * seed->x[1];
    operand[0] = seed->u[0];
}
