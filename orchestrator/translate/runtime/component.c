/* Life cycle of an instance and access to its variables by value reference. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "runtime.h"

/* Per internal step and relative to a state's size; with it the error over hundreds of steps stays
 * below 1e-8. Explicit steps this accurate are short anyway, so a looser one would save little. */
static const double TOLERANCE = 1e-10;
static const double TIGHTEST = 1e-13;

/* Hand out the next n numbers of a block, or only count them while there is no block. */
static double *take(double *block, size_t *used, int n)
{
    double *at = block ? block + *used : NULL;
    *used += (size_t)n;
    return at;
}

static size_t lay_out_saved(Runtime *rt, double *block)
{
    const ModelInfo *i = &model_info;
    size_t used = 0;
    rt->x = take(block, &used, i->n_x);
    rt->u = take(block, &used, i->n_u);
    rt->p = take(block, &used, i->n_p);
    rt->u1 = take(block, &used, i->n_u);
    rt->u2 = take(block, &used, i->n_u);
    rt->u_before = take(block, &used, i->n_u);
    rt->m = take(block, &used, i->n_m);
    rt->m_done = take(block, &used, i->n_m);
    rt->d = take(block, &used, i->n_d);
    rt->k1 = take(block, &used, i->n_x);
    rt->operand = take(block, &used, i->n_d);
    rt->lag = take(block, &used, i->n_d);
    rt->warned = take(block, &used, i->n_a);
    return used;
}

static size_t lay_out_scratch(Runtime *rt, double *block)
{
    const ModelInfo *i = &model_info;
    size_t used = 0;
    rt->k[0] = rt->k1;
    for (int s = 1; s < 7; s++) rt->k[s] = take(block, &used, i->n_x);
    for (int s = 0; s < 5; s++) rt->dense[s] = take(block, &used, i->n_x);
    rt->x_new = take(block, &used, i->n_x);
    rt->x_stage = take(block, &used, i->n_x);
    rt->u_stage = take(block, &used, i->n_u);
    rt->u_now = take(block, &used, i->n_u);
    rt->d_stage = take(block, &used, i->n_d);
    rt->operand_stage = take(block, &used, i->n_d);
    rt->lag_stage = take(block, &used, i->n_d);
    rt->samples = take(block, &used, 5 * i->n_d);
    rt->guess = take(block, &used, 5 * i->n_d);
    rt->relations = take(block, &used, i->n_m);
    rt->assertions = take(block, &used, i->n_a);
    rt->w = take(block, &used, i->n_w);
    rt->xdot = take(block, &used, i->n_x);
    rt->nominal = take(block, &used, i->n_x);
    rt->t_x = take(block, &used, i->n_x);
    rt->t_u = take(block, &used, i->n_u);
    rt->t_p = take(block, &used, i->n_p);
    rt->t_d = take(block, &used, i->n_d);
    rt->t_xdot = take(block, &used, i->n_x);
    rt->t_w = take(block, &used, i->n_w);
    rt->t_operand = take(block, &used, i->n_d);
    return used;
}

static void *zeroed(size_t n, size_t size)
{
    return calloc(n ? n : 1, size);
}

Runtime *rt_new(const char *instance_name, const char *token, const char *resources, char *why, size_t room)
{
    Runtime *rt;
    size_t length = strlen(instance_name) + 1, n_d = (size_t)model_info.n_d;
    (void)resources;
    if (!token || strcmp(token, model_info.token) != 0) {
        snprintf(why, room, "the GUID or instantiation token is not that of this binary: "
                            "modelDescription.xml belongs to another build");
        return NULL;
    }
    snprintf(why, room, "no memory");
    rt = zeroed(1, sizeof *rt);
    if (!rt) return NULL;
    rt->n_saved = lay_out_saved(rt, NULL);
    rt->saved = zeroed(rt->n_saved, sizeof(double));
    rt->scratch = zeroed(lay_out_scratch(rt, NULL), sizeof(double));
    rt->delays = zeroed(n_d, sizeof *rt->delays);
    rt->rings = zeroed(n_d, sizeof *rt->rings);
    rt->capacities = zeroed(n_d, sizeof *rt->capacities);
    rt->crossed = zeroed(n_d, sizeof *rt->crossed);
    rt->levels = zeroed(n_d, sizeof *rt->levels);
    rt->instance_name = zeroed(length, 1);
    if (!rt->saved || !rt->scratch || !rt->delays || !rt->rings || !rt->capacities || !rt->crossed ||
        !rt->levels || !rt->instance_name) {
        rt_free(rt);
        return NULL;
    }
    memcpy(rt->instance_name, instance_name, length);
    lay_out_saved(rt, rt->saved);
    lay_out_scratch(rt, rt->scratch);
    rt_reset(rt);
    return rt;
}

void rt_free(Runtime *rt)
{
    if (!rt) return;
    for (int j = 0; rt->rings && j < model_info.n_d; j++) free(rt->rings[j]);
    free(rt->saved);
    free(rt->scratch);
    free(rt->delays);
    free(rt->rings);
    free(rt->capacities);
    free(rt->crossed);
    free(rt->levels);
    free(rt->instance_name);
    free(rt->functions);
    free(rt);
}

RtStatus rt_terminate(Runtime *rt)
{
    rt->s.phase = PHASE_TERMINATED;
    return RT_OK;
}

/* Everything as after instantiation; memory for histories is kept. */
RtStatus rt_reset(Runtime *rt)
{
    memset(&rt->s, 0, sizeof rt->s);
    if (rt->n_saved) memset(rt->saved, 0, rt->n_saved * sizeof(double));
    for (int j = 0; j < model_info.n_d; j++) memset(&rt->delays[j], 0, sizeof rt->delays[j]);
    for (int i = 0; i < model_info.n_variables; i++) {
        const ModelVariable *v = &model_variables[i];
        if (v->kind == KIND_STATE) {
            rt->x[v->index] = v->start;
            rt->nominal[v->index] = v->nominal;
        }
        if (v->kind == KIND_INPUT) rt->u[v->index] = v->start;
        if (v->kind == KIND_PARAMETER) rt->p[v->index] = v->start;
    }
    rt->s.phase = PHASE_INSTANTIATED;
    rt->s.tolerance = TOLERANCE;
    rt->s.last_event = -INFINITY;
    rt->s.parameters_stale = rt->s.modes_stale = rt->s.outputs_stale = rt->s.derivatives_stale = 1;
    return RT_OK;
}

RtStatus rt_set_up(Runtime *rt, int tolerance_defined, double tolerance, double start_time, int stop_defined,
                   double stop_time)
{
    if (!isfinite(start_time) || (stop_defined && !(stop_time >= start_time)) ||
        (tolerance_defined && !(tolerance > 0 && isfinite(tolerance)))) {
        rt_log(rt, RT_ERROR,
               "start time %.9g s, stop time %.9g s, tolerance %.9g: times must be finite and in order, "
               "the tolerance above 0",
               start_time, stop_defined ? stop_time : INFINITY, tolerance_defined ? tolerance : 0);
        return RT_ERROR;
    }
    rt->s.start_time = rt->s.time = rt->s.last_success = start_time;
    rt->s.stop_defined = stop_defined;
    rt->s.stop_time = stop_time;
    /* Importers pass plotting accuracy here by default; only a tighter wish than our own is followed. */
    rt->s.tolerance = tolerance_defined && tolerance < TOLERANCE ? fmax(tolerance, TIGHTEST) : TOLERANCE;
    return RT_OK;
}

RtStatus rt_enter_initialization(Runtime *rt)
{
    rt->s.phase = PHASE_INITIALIZATION;
    rt->s.modes_stale = 1;
    return RT_OK;
}

RtStatus rt_exit_initialization(Runtime *rt)
{
    RtStatus status;
    rt->s.modes_stale = 1;
    status = rt_refresh_modes(rt);
    if (status == RT_OK) {
        memcpy(rt->m_done, rt->m, (size_t)model_info.n_m * sizeof(double));
        memcpy(rt->u_before, rt->u, (size_t)model_info.n_u * sizeof(double));
        if (delay_start(rt) || rt_settle(rt)) status = rt->trouble;
    }
    if (status == RT_OK) status = rt_check_assertions(rt);
    if (status >= RT_DISCARD) {
        rt->s.phase = PHASE_ERROR;
        return rt_report(rt, "ExitInitializationMode");
    }
    rt->s.first_stage_valid = 0;
    rt->s.outputs_stale = rt->s.derivatives_stale = 1;
    rt->s.phase = PHASE_STEP;
    return status;
}

static const char *type_name(ModelType type)
{
    return type == TYPE_REAL ? "Real" : type == TYPE_INTEGER ? "Integer" : "Boolean";
}

/* NULL, with a message, if there is no such variable. */
const ModelVariable *rt_variable(Runtime *rt, const char *call, unsigned reference)
{
    if (reference < (unsigned)model_info.n_variables) return &model_variables[reference];
    rt_log(rt, RT_ERROR, "%s: unknown value reference %u; %s has 0 to %d", call, reference, model_info.name,
           model_info.n_variables - 1);
    return NULL;
}

static const ModelVariable *typed(Runtime *rt, const char *call, unsigned reference, ModelType type)
{
    const ModelVariable *v = rt_variable(rt, call, reference);
    if (!v || v->type == type) return v;
    rt_log(rt, RT_ERROR, "%s: %s (value reference %u) is of type %s, not %s", call, v->name, reference,
           type_name(v->type), type_name(type));
    return NULL;
}

/* Outputs are computed on demand from the inputs of now, so feed-through is seen before the next step. */
RtStatus rt_get(Runtime *rt, unsigned reference, ModelType type, double *value)
{
    const ModelVariable *v = typed(rt, "Get", reference, type);
    RtStatus status = RT_OK;
    if (!v) return RT_ERROR;
    switch (v->kind) {
    case KIND_TIME: *value = rt->s.time; return RT_OK;
    case KIND_INPUT: *value = rt->u[v->index]; return RT_OK;
    case KIND_PARAMETER:
    case KIND_STATE:
        if (rt->s.parameters_stale) status = rt_refresh_modes(rt);
        *value = v->kind == KIND_STATE ? rt->x[v->index] : rt->p[v->index];
        break;
    case KIND_ALGEBRAIC:
        status = rt_refresh_outputs(rt);
        *value = rt->w[v->index];
        break;
    default: status = rt_refresh_derivatives(rt); *value = rt->xdot[v->index];
    }
    if (status >= RT_DISCARD) {
        rt_log(rt, status, "Get %s: %s", v->name, rt->trouble_text);
        return status;
    }
    if (!isfinite(*value)) {
        rt_log(rt, RT_WARNING, "Get: %s is %g at t = %.9g s", v->name, *value, rt->s.time);
        return RT_WARNING;
    }
    return RT_OK;
}

RtStatus rt_set(Runtime *rt, unsigned reference, ModelType type, double value)
{
    const ModelVariable *v = typed(rt, "Set", reference, type);
    double *place;
    if (!v) return RT_ERROR;
    if (!v->settable) {
        rt_log(rt, RT_ERROR,
               "Set: %s (value reference %u) cannot be set; inputs, independent parameters and free "
               "start values can",
               v->name, reference);
        return RT_ERROR;
    }
    if (v->kind != KIND_INPUT && !(rt->s.phase & (PHASE_INSTANTIATED | PHASE_INITIALIZATION))) {
        rt_log(rt, RT_ERROR, "Set: %s is %s: it can be set before the end of initialisation only", v->name,
               v->kind == KIND_PARAMETER ? "a fixed parameter" : "a start value");
        return RT_ERROR;
    }
    if (!isfinite(value)) {
        rt_log(rt, RT_ERROR, "Set: %s cannot be %g; give a finite number", v->name, value);
        return RT_ERROR;
    }
    place = v->kind == KIND_INPUT       ? &rt->u[v->index]
            : v->kind == KIND_PARAMETER ? &rt->p[v->index]
                                        : &rt->x[v->index];
    if (v->kind == KIND_INPUT) rt->u1[v->index] = rt->u2[v->index] = 0;
    /* Bitwise: 0 and -0 are different inputs. */
    if (memcmp(place, &value, sizeof value) == 0) return RT_OK;
    *place = value;
    if (v->kind != KIND_INPUT) rt->s.parameters_stale = 1;
    rt->s.modes_stale = rt->s.outputs_stale = rt->s.derivatives_stale = 1;
    return RT_OK;
}

/* For the coming step only; setting the input itself afterwards takes its derivatives back to zero. */
RtStatus rt_set_input_derivative(Runtime *rt, unsigned reference, int order, double value)
{
    const ModelVariable *v = typed(rt, "SetRealInputDerivatives", reference, TYPE_REAL);
    if (!v) return RT_ERROR;
    if (v->kind != KIND_INPUT || order < 1 || order > 2 || !isfinite(value)) {
        rt_log(rt, RT_ERROR,
               "SetRealInputDerivatives: %s, order %d, value %g: only inputs have derivatives, of order 1 "
               "or 2, finite",
               v->name, order, value);
        return RT_ERROR;
    }
    (order == 1 ? rt->u1 : rt->u2)[v->index] = value;
    rt->s.slopes = 1;
    return RT_OK;
}
