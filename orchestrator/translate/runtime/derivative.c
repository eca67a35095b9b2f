/* Directional derivatives of derivatives and algebraic variables with respect to inputs and states. */
#include <math.h>
#include <string.h>

#include "runtime.h"

static void clear(double *a, int n)
{
    if (n) memset(a, 0, (size_t)n * sizeof *a);
}

/* Variation of the delay times along the seed, by central differences: the model gives no derivative of
 * them. A delay time that does not depend on the seed's variables gives exactly zero. */
static void lag_tangent(Runtime *rt, const double *d, double *tangent)
{
    int n_x = model_info.n_x, n_u = model_info.n_u, n_d = model_info.n_d;
    double step = INFINITY;
    double *plus = tangent, *minus = rt->lag_stage;
    for (int i = 0; i < n_x; i++)
        if (rt->t_x[i] != 0) step = fmin(step, (fabs(rt->x[i]) + rt->nominal[i]) / fabs(rt->t_x[i]));
    for (int i = 0; i < n_u; i++)
        if (rt->t_u[i] != 0) step = fmin(step, (fabs(rt->u[i]) + 1) / fabs(rt->t_u[i]));
    if (isinf(step)) step = 1;
    step *= 6e-6; /* cube root of the machine precision balances truncation and rounding */
    for (int side = 1; side >= -1; side -= 2) {
        ModelPoint at = {rt->s.time, rt->x_stage, rt->u_stage, rt->p, rt->d_stage, rt->m};
        for (int i = 0; i < n_x; i++) rt->x_stage[i] = rt->x[i] + side * step * rt->t_x[i];
        for (int i = 0; i < n_u; i++) rt->u_stage[i] = rt->u[i] + side * step * rt->t_u[i];
        for (int j = 0; j < n_d; j++) rt->d_stage[j] = d[j] + side * step * rt->t_d[j];
        model_delays(&at, rt->operand_stage, side > 0 ? plus : minus);
    }
    for (int j = 0; j < n_d; j++) tangent[j] = (plus[j] - minus[j]) / (2 * step);
}

/* Forward derivatives at the present time for the seed in t_x and t_u: results in t_xdot and t_w. An
 * operator of zero delay passes its operand's variation on; one of positive delay varies with its delay
 * time only. */
static void tangent(Runtime *rt)
{
    ModelPoint at = {rt->s.time, rt->x, rt->u, rt->p, rt->d, rt->m};
    ModelPoint seed = {0, rt->t_x, rt->t_u, rt->t_p, rt->t_d, NULL};
    int n_d = model_info.n_d;
    clear(rt->t_p, model_info.n_p);
    clear(rt->t_d, n_d);
    rt->stepping = 0;
    /* Entry j depends on the values of operators before it only. */
    for (int pass = 0; pass < n_d; pass++) {
        double *lag_change = rt->samples; /* scratch between steps */
        model_tangent(&at, &seed, rt->t_xdot, rt->t_w, rt->t_operand);
        if (rt->s.started) lag_tangent(rt, rt->d, lag_change);
        for (int j = 0; j < n_d; j++) {
            if (!rt->s.started || rt->lag[j] <= 0) rt->t_d[j] = rt->t_operand[j];
            else
                rt->t_d[j] =
                    lag_change[j] == 0 ? 0 : -lag_change[j] * delay_slope(rt, j, rt->s.time - rt->lag[j]);
        }
    }
    model_tangent(&at, &seed, rt->t_xdot, rt->t_w, rt->t_operand);
}

/* Where the variation of a known variable goes; NULL, with a message, if it is not input or state. */
static double *known_place(Runtime *rt, unsigned reference)
{
    const ModelVariable *v = rt_variable(rt, "GetDirectionalDerivative", reference);
    if (!v) return NULL;
    if (v->kind == KIND_INPUT && v->type == TYPE_REAL) return &rt->t_u[v->index];
    if (v->kind == KIND_STATE) return &rt->t_x[v->index];
    rt_log(rt, RT_ERROR, "GetDirectionalDerivative: %s cannot be a known; Real inputs and states can",
           v->name);
    return NULL;
}

/* Where the variation of an unknown comes from. */
static double *unknown_place(Runtime *rt, unsigned reference)
{
    const ModelVariable *v = rt_variable(rt, "GetDirectionalDerivative", reference);
    if (!v) return NULL;
    if (v->kind == KIND_ALGEBRAIC && v->type == TYPE_REAL) return &rt->t_w[v->index];
    if (v->kind == KIND_DERIVATIVE) return &rt->t_xdot[v->index];
    if (v->kind == KIND_STATE) return &rt->t_x[v->index];
    rt_log(rt, RT_ERROR,
           "GetDirectionalDerivative: %s cannot be an unknown; Real outputs, algebraic variables, "
           "states and derivatives can",
           v->name);
    return NULL;
}

static RtStatus prepare(Runtime *rt, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                        size_t n_knowns)
{
    RtStatus status;
    for (size_t i = 0; i < n_unknowns; i++)
        if (!unknown_place(rt, unknowns[i])) return RT_ERROR;
    for (size_t i = 0; i < n_knowns; i++)
        if (!known_place(rt, knowns[i])) return RT_ERROR;
    status = rt_refresh_modes(rt);
    if (status == RT_OK) status = rt_refresh_outputs(rt);
    if (status != RT_OK) return rt_report(rt, "GetDirectionalDerivative");
    clear(rt->t_x, model_info.n_x);
    clear(rt->t_u, model_info.n_u);
    return RT_OK;
}

/* sensitivity = J seed, J the Jacobian of the unknowns with respect to the knowns. */
RtStatus rt_directional(Runtime *rt, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                        size_t n_knowns, const double *seed, double *sensitivity)
{
    RtStatus status = prepare(rt, unknowns, n_unknowns, knowns, n_knowns);
    if (status != RT_OK) return status;
    for (size_t i = 0; i < n_knowns; i++) *known_place(rt, knowns[i]) += seed[i];
    tangent(rt);
    for (size_t i = 0; i < n_unknowns; i++) sensitivity[i] = *unknown_place(rt, unknowns[i]);
    return RT_OK;
}

/* sensitivity = transpose(J) seed, one forward derivative for each known. */
RtStatus rt_adjoint(Runtime *rt, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                    size_t n_knowns, const double *seed, double *sensitivity)
{
    RtStatus status = prepare(rt, unknowns, n_unknowns, knowns, n_knowns);
    if (status != RT_OK) return status;
    for (size_t k = 0; k < n_knowns; k++) {
        *known_place(rt, knowns[k]) = 1;
        tangent(rt);
        sensitivity[k] = 0;
        for (size_t i = 0; i < n_unknowns; i++) sensitivity[k] += seed[i] * *unknown_place(rt, unknowns[i]);
        *known_place(rt, knowns[k]) = 0;
    }
    return RT_OK;
}
