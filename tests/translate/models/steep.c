/* Slopes as steep as asked for: x' = speed (hold - x) / (|x - hold| + width), without an event: a jump where
 * `width` is 0, the time constant width/speed near by. z' = -z / sqrt(|z| + 1e-12), with an event at 0,
 * which ends as exp(-1e6 t). */
#include <math.h>
#define HAS_STATES
#define HAS_RELATIONS
#include "defaults.h"

const ModelInfo model_info = {"steep", "{steep}", 6, 2, 0, 3, 0, 0, 1, 0};

const ModelVariable model_variables[] = {
    {"time", KIND_TIME, 0, TYPE_REAL, 0, 0, 1},
    {"z", KIND_STATE, 0, TYPE_REAL, 1, 0, 1},
    {"x", KIND_STATE, 1, TYPE_REAL, 1, 1, 1},
    {"speed", KIND_PARAMETER, 0, TYPE_REAL, 1, 0, 1},
    {"width", KIND_PARAMETER, 1, TYPE_REAL, 1, 1, 1},
    {"hold", KIND_PARAMETER, 2, TYPE_REAL, 1, 0, 1},
};

void model_derivatives(const ModelPoint *at, double *xdot)
{
    double off = at->x[1] - at->p[2];
    xdot[0] = -at->x[0] / sqrt((at->m[0] != 0 ? at->x[0] : -at->x[0]) + 1e-12);
    xdot[1] = off == 0 ? 0 : -at->p[0] * off / (fabs(off) + at->p[1]);
}

void model_algebraics(const ModelPoint *at, double *w)
{
    (void)at;
    (void)w;
}

const int model_relation_strict[] = {0};
void model_relations(const ModelPoint *at, double *r)
{
    r[0] = at->x[0];
}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    double size = fabs(at->x[0]) + 1e-12, off = fabs(at->x[1] - at->p[2]) + at->p[1];
    (void)w;
    (void)operand;
    xdot[0] = -seed->x[0] * (size + 1e-12) / (2 * size * sqrt(size));
    xdot[1] = -at->p[0] * at->p[1] / (off * off) * seed->x[1];
}
