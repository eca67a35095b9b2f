/* Neither states nor a clock: force = -k x - c v while x > 0; y = delay(force, lag), all from inputs. */
#define HAS_DELAYS
#define HAS_RELATIONS
#include "defaults.h"

const ModelInfo model_info = {"gap", "{gap}", 8, 0, 3, 2, 2, 1, 1, 0};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"x", KIND_INPUT, 0, TYPE_REAL, 1, 0, 1},
    {"v", KIND_INPUT, 1, TYPE_REAL, 1, 0, 1},
    {"lag", KIND_INPUT, 2, TYPE_REAL, 1, 0, 1},
    {"k", KIND_PARAMETER, 0, TYPE_REAL, 1, 10, 1},
    {"c", KIND_PARAMETER, 1, TYPE_REAL, 1, 0.5, 1},
    {"force", KIND_ALGEBRAIC, 0, TYPE_REAL, 0, 0, 1},
    {"y", KIND_ALGEBRAIC, 1, TYPE_REAL, 0, 0, 1},
};

static double force(const ModelPoint *at)
{
    return at->m[0] != 0 ? -at->p[0] * at->u[0] - at->p[1] * at->u[1] : 0;
}

void model_algebraics(const ModelPoint *at, double *w)
{
    w[0] = force(at);
    w[1] = at->d[0];
}

void model_delays(const ModelPoint *at, double *operand, double *delay_time)
{
    operand[0] = force(at);
    delay_time[0] = at->u[2];
}

void model_delay_maxima(const double *p, double *maximum)
{
    (void)p;
    maximum[0] = 1;
}

const int model_relation_strict[] = {1};
void model_relations(const ModelPoint *at, double *r) { r[0] = at->u[0]; }

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    (void)xdot;
    w[0] = at->m[0] != 0 ? -at->p[0] * seed->u[0] - at->p[1] * seed->u[1] : 0;
    w[1] = seed->d[0];
    operand[0] = w[0];
}
