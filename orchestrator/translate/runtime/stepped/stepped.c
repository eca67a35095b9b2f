/* A component that advances in steps, behind the same life cycle, states and interfaces as other models.
 *
 * It stands in for evaluate.c, delay.c, integrate.c and step.c: there is nothing to integrate between two
 * communication points, no event and no delay operator.
 */
#include <float.h>
#include <math.h>
#include <string.h>

#include "runtime.h"
#include "stepmodel.h"

static StepPoint here(const Runtime *rt, double time, double size)
{
    StepPoint at = {time, size, rt->x, rt->u, rt->p};
    return at;
}

static RtStatus tell(Runtime *rt, int outcome, const StepPoint *at)
{
    char message[700];
    Text text = {message, sizeof message, 0};
    RtStatus status = (RtStatus)step_status(outcome);
    message[0] = 0;
    step_message(outcome, at, rt->instance_name, &text);
    /* Unlike rt_report, which has room for half of it. */
    rt_log(rt, status, "%s", message);
    return status;
}

/* Take over the states that a call computed, unless it refused. */
static RtStatus take_over(Runtime *rt, int outcome, const StepPoint *at)
{
    RtStatus status = outcome ? tell(rt, outcome, at) : RT_OK;
    if (status < RT_DISCARD && model_info.n_x)
        memcpy(rt->x, rt->x_new, (size_t)model_info.n_x * sizeof(double));
    rt->s.outputs_stale = 1;
    return status;
}

/* States that follow from the start time are set like dependent start values. */
RtStatus rt_refresh_modes(Runtime *rt)
{
    rt->s.modes_stale = 0;
    if (rt->s.parameters_stale) {
        rt->s.parameters_stale = 0;
        if (rt->s.phase & (PHASE_INSTANTIATED | PHASE_INITIALIZATION)) {
            StepPoint at = here(rt, rt->s.start_time, 0);
            RtStatus status = take_over(rt, step_set_up(&at, rt->x_new), &at);
            if (status >= RT_DISCARD) {
                rt_fail(rt, status, "the start time %.9g s is refused", rt->s.start_time);
                return status;
            }
        }
    }
    return RT_OK;
}

RtStatus rt_refresh_outputs(Runtime *rt)
{
    ModelPoint at = {rt->s.time, rt->x, rt->u, rt->p, rt->d, rt->m};
    RtStatus status = rt_refresh_modes(rt);
    if (status >= RT_DISCARD || !rt->s.outputs_stale) return status;
    model_algebraics(&at, rt->w);
    rt->s.outputs_stale = 0;
    return RT_OK;
}

RtStatus rt_refresh_derivatives(Runtime *rt)
{
    (void)rt; /* no variable is a derivative */
    return RT_OK;
}

int rt_settle(Runtime *rt)
{
    rt->s.modes_stale = 0;
    return 0;
}

/* Called once, where initialisation ends: the component's own checks. */
RtStatus rt_check_assertions(Runtime *rt)
{
    StepPoint at = here(rt, rt->s.start_time, 0);
    RtStatus status = take_over(rt, step_initialise(&at, rt->x_new), &at);
    if (status >= RT_DISCARD) rt_fail(rt, status, "initialisation is refused");
    return status;
}

int delay_start(Runtime *rt)
{
    rt->s.started = 1;
    return 0;
}

double delay_slope(Runtime *rt, int j, double time)
{
    (void)rt, (void)j, (void)time;
    return 0;
}

void model_delays(const ModelPoint *at, double *operand, double *delay_time)
{
    (void)at, (void)operand, (void)delay_time;
}

static int legal_step(Runtime *rt, double point, double size)
{
    double now = rt->s.time;
    /* A master that sums its steps up may be off by rounding errors. */
    double close = 1e-3 * fabs(size) + 16 * DBL_EPSILON * fabs(now);
    if (!(size > 0) || !isfinite(size) || !isfinite(point))
        return !rt_fail(rt, RT_ERROR,
                        "from %.9g s by %.9g s: both have to be finite, the step size above 0 s", point, size);
    if (fabs(point - now) > close)
        return !rt_fail(rt, RT_ERROR, "from %.17g s: the instance is at %.17g s", point, now);
    if (rt->s.stop_defined && point + size > rt->s.stop_time + 1e-9 * fmax(fabs(rt->s.stop_time), size))
        return !rt_fail(rt, RT_ERROR, "to %.9g s: passes the stop time %.9g s", point + size,
                        rt->s.stop_time);
    if (rt->s.slopes)
        return !rt_fail(
            rt, RT_ERROR, "derivatives of inputs are set; inputs are held (canInterpolateInputs is false)");
    return 1;
}

RtStatus rt_do_step(Runtime *rt, double point, double size)
{
    StepPoint at = here(rt, point, size);
    RtStatus status;
    rt->s.last_success = rt->s.time;
    /* A refusal changes nothing: the instance can go on. */
    if (!legal_step(rt, point, size)) {
        rt->s.slopes = 0;
        return rt_report(rt, "DoStep");
    }
    status = take_over(rt, step_advance(&at, rt->x_new), &at);
    if (status == RT_DISCARD) return status;
    if (status > RT_DISCARD) {
        rt->s.phase = PHASE_ERROR;
        return status;
    }
    rt->s.time = rt->s.last_success = point + size;
    return status;
}
