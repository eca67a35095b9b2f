/* The model's functions at a point: derivatives, outputs, and the modes that agree with it. */
#include <math.h>
#include <string.h>

#include "runtime.h"

/* Inputs at a time of the communication step: constant, or the polynomial of the set derivatives. */
const double *rt_inputs(Runtime *rt, double time)
{
    double since = time - rt->step_start;
    if (!rt->s.slopes) return rt->u;
    for (int i = 0; i < model_info.n_u; i++)
        rt->u_stage[i] = rt->u[i] + since * (rt->u1[i] + since / 2 * rt->u2[i]);
    return rt->u_stage;
}

/* x' within an internal step, modes and pieces held; operands and delay times come along. */
int rt_field(Runtime *rt, double time, const double *x, double *xdot, double *operand, double *lag)
{
    ModelPoint at = {time, x, rt_inputs(rt, time), rt->p, rt->d_stage, rt->m};
    if (model_info.n_d && delay_values(rt, &at, rt->d_stage, operand, lag, READ_FROZEN)) return 1;
    if (model_info.n_x) model_derivatives(&at, xdot);
    return 0;
}

static int truth(int i, double r)
{
    return model_relation_strict[i] ? r > 0 : r >= 0;
}

/* Iterate the modes at the present time, from their present values, until they agree with the relations.
 * Leaves values, operands, delay times and pieces of the delay operators of the present time behind. */
int rt_settle(Runtime *rt)
{
    int n = model_info.n_m;
    int limit = 4 * n + 8;
    ModelPoint at = {rt->s.time, rt->x, rt->u, rt->p, rt->d, rt->m};
    rt->stepping = 0;
    for (int iteration = 0;; iteration++) {
        int changes = 0, last = 0;
        if (model_info.n_d && delay_values(rt, &at, rt->d, rt->operand, rt->lag, READ_SELECT)) return 1;
        if (!n) return 0;
        model_relations(&at, rt->relations);
        for (int i = 0; i < n; i++) {
            double now;
            if (isnan(rt->relations[i]))
                return rt_fail(rt, RT_ERROR, "relation %d at t = %.9g s is not a number", i + 1, rt->s.time);
            now = truth(i, rt->relations[i]);
            if (now != rt->m[i]) {
                /* Changing all at once may go round in circles where one after the other settles. */
                if (iteration <= 2 * n + 4 || changes == 0) rt->m[i] = now;
                changes++;
                last = i;
            }
        }
        if (!changes) return 0;
        if (iteration >= limit)
            return rt_fail(
                rt, RT_ERROR,
                "event iteration at t = %.9g s does not converge: after %d rounds relation %d still changes",
                rt->s.time, iteration, last + 1);
    }
}

/* Agree with inputs set since. The iteration always starts from the modes of the past step's end, so it
 * makes no difference what else was set and read in between. */
RtStatus rt_refresh_modes(Runtime *rt)
{
    if (rt->s.parameters_stale) {
        model_dependent_parameters(rt->p);
        model_dependent_starts(rt->p, rt->x);
        rt->s.parameters_stale = 0;
        rt->s.modes_stale = 1;
    }
    if (rt->s.modes_stale) {
        memcpy(rt->m, rt->m_done, (size_t)model_info.n_m * sizeof(double));
        if (rt_settle(rt)) return rt->trouble;
        rt->s.modes_stale = 0;
        rt->s.outputs_stale = rt->s.derivatives_stale = 1;
    }
    return RT_OK;
}

static RtStatus present(Runtime *rt, ModelPoint *at)
{
    RtStatus status = rt_refresh_modes(rt);
    ModelPoint now = {rt->s.time, rt->x, rt->u, rt->p, rt->d, rt->m};
    *at = now;
    if (status != RT_OK) return status;
    rt->stepping = 0;
    /* To scratch: reading an output must not touch what the next step starts from. */
    if (model_info.n_d && delay_values(rt, at, rt->d, rt->operand_stage, rt->lag_stage, READ_SELECT))
        return rt->trouble;
    return RT_OK;
}

RtStatus rt_refresh_outputs(Runtime *rt)
{
    ModelPoint at;
    RtStatus status;
    if (!rt->s.outputs_stale && !rt->s.modes_stale && !rt->s.parameters_stale) return RT_OK;
    status = present(rt, &at);
    if (status != RT_OK) return status;
    model_algebraics(&at, rt->w);
    rt->s.outputs_stale = 0;
    return RT_OK;
}

RtStatus rt_refresh_derivatives(Runtime *rt)
{
    ModelPoint at;
    RtStatus status;
    if (!rt->s.derivatives_stale && !rt->s.modes_stale && !rt->s.parameters_stale) return RT_OK;
    status = present(rt, &at);
    if (status != RT_OK) return status;
    model_derivatives(&at, rt->xdot);
    rt->s.derivatives_stale = 0;
    return RT_OK;
}

/* Assertions at the present time; a violated warning is logged the first time. */
RtStatus rt_check_assertions(Runtime *rt)
{
    RtStatus status = RT_OK;
    ModelPoint at = {rt->s.time, rt->x, rt->u, rt->p, rt->d, rt->m};
    if (!model_info.n_a) return RT_OK;
    rt->stepping = 0;
    if (model_info.n_d && delay_values(rt, &at, rt->d, rt->operand_stage, rt->lag_stage, READ_SELECT))
        return rt->trouble;
    model_assertions(&at, rt->assertions);
    for (int i = 0; i < model_info.n_a; i++) {
        if (rt->assertions[i] != 0) continue;
        if (model_assertion_is_error[i]) {
            rt_fail(rt, RT_ERROR, "assertion violated at t = %.9g s: %s", rt->s.time,
                    model_assertion_messages[i]);
            return RT_ERROR;
        }
        if (rt->warned[i] != 0) continue;
        rt->warned[i] = 1;
        rt_log(rt, RT_WARNING, "assertion violated at t = %.9g s (told once): %s", rt->s.time,
               model_assertion_messages[i]);
        status = RT_WARNING;
    }
    return status;
}

const char *rt_state_name(int index)
{
    for (int i = 0; i < model_info.n_variables; i++)
        if (model_variables[i].kind == KIND_STATE && model_variables[i].index == index)
            return model_variables[i].name;
    return "?";
}
