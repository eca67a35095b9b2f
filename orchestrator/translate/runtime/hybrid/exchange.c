/* Model exchange, and steps that end early, behind both versions of FMI. */
#include <math.h>
#include <string.h>

#include "exchange.h"

static StepPoint here(const Runtime *rt)
{
    StepPoint at = {rt->s.time, 0, rt->x, rt->u, rt->p};
    return at;
}

static RtStatus tell(Runtime *rt, int outcome, const StepPoint *at)
{
    char message[700];
    Text text = {message, sizeof message, 0};
    RtStatus status = (RtStatus)step_status(outcome);
    if (!outcome) return RT_OK;
    message[0] = 0;
    step_message(outcome, at, rt->instance_name, &text);
    rt_log(rt, status, "%s", message);
    return status;
}

/* Whatever follows from states, time and inputs is to be computed again. */
static void moved(Runtime *rt)
{
    rt->s.outputs_stale = rt->s.derivatives_stale = 1;
}

void me_begin(Runtime *rt, HybridUse use)
{
    rt->x[hybrid_info.use_slot] = use;
}

HybridUse me_use(const Runtime *rt)
{
    return (HybridUse)rt->x[hybrid_info.use_slot];
}

int me_legal(Runtime *rt, const char *call, int phases, int uses)
{
    HybridUse use = me_use(rt);
    static const char *const names[] = {"steps (Co-Simulation)", "Event Mode", "Continuous-Time Mode"};
    if (!rt_legal(rt, call, phases)) return 0;
    /* Before the end of initialisation there are no modes yet. */
    if (rt->s.phase != PHASE_STEP && use > 0) use = USE_EVENT_MODE, uses |= uses & IN_EXCHANGE ? IN_EXCHANGE : 0;
    if (uses & 1 << (use < 0 ? 0 : use)) return 1;
    rt_log(rt, RT_ERROR, "%s: illegal call in %s", call, names[use < 0 ? 0 : use]);
    return 0;
}

RtStatus me_enter(Runtime *rt, HybridUse use)
{
    rt->x[hybrid_info.use_slot] = use;
    moved(rt);
    return RT_OK;
}

RtStatus me_set_time(Runtime *rt, double time)
{
    if (!isfinite(time)) {
        rt_log(rt, RT_ERROR, "SetTime: %g is no time", time);
        return RT_ERROR;
    }
    rt->s.time = rt->s.last_success = time;
    moved(rt);
    return RT_OK;
}

static int counted(Runtime *rt, const char *call, size_t given, int wanted)
{
    if (given == (size_t)wanted) return 1;
    rt_log(rt, RT_ERROR, "%s: room for %d values, there are %d", call, (int)given, wanted);
    return 0;
}

RtStatus me_set_states(Runtime *rt, const char *call, const double *x, size_t n)
{
    if (!counted(rt, call, n, hybrid_info.n_states)) return RT_ERROR;
    for (size_t k = 0; k < n; k++) {
        if (!isfinite(x[k])) {
            rt_log(rt, RT_DISCARD, "%s: state %d cannot be %g", call, (int)k + 1, x[k]);
            return RT_DISCARD;
        }
    }
    for (size_t k = 0; k < n; k++) rt->x[hybrid_info.state_slots[k]] = x[k];
    moved(rt);
    return RT_OK;
}

/* Up to the end of initialisation states follow from start values; later they are the importer's. */
RtStatus me_states(Runtime *rt, const char *call, double *x, size_t n)
{
    RtStatus status = rt_refresh_modes(rt);
    if (!counted(rt, call, n, hybrid_info.n_states)) return RT_ERROR;
    if (status >= RT_DISCARD) return rt_report(rt, call);
    for (size_t k = 0; k < n; k++) x[k] = rt->x[hybrid_info.state_slots[k]];
    return RT_OK;
}

RtStatus me_nominals(Runtime *rt, const char *call, double *x, size_t n)
{
    if (!counted(rt, call, n, hybrid_info.n_states)) return RT_ERROR;
    for (size_t k = 0; k < n; k++) x[k] = hybrid_info.nominals[k];
    return RT_OK;
}

/* Solve the equations in the present modes; z holds the solution, from which the next one starts. */
static RtStatus evaluated(Runtime *rt, double *margins)
{
    StepPoint at = here(rt);
    RtStatus status = rt_refresh_modes(rt);
    int outcome;
    if (status >= RT_DISCARD) return rt_report(rt, "Get");
    if (rt->s.phase != PHASE_STEP) {
        /* The initial system has given all values already. */
        if (margins) memset(margins, 0, (size_t)hybrid_info.n_margins * sizeof(double));
        return RT_OK;
    }
    memcpy(rt->x_new, rt->x, (size_t)hybrid_info.n_z * sizeof(double));
    outcome = exchange_evaluate(&at, rt->x_new, margins);
    if (outcome) {
        tell(rt, outcome, &at);
        return RT_DISCARD;
    }
    memcpy(rt->x, rt->x_new, (size_t)hybrid_info.n_z * sizeof(double));
    return RT_OK;
}

RtStatus me_derivatives(Runtime *rt, const char *call, double *f, size_t n)
{
    RtStatus status;
    if (!counted(rt, call, n, hybrid_info.n_states)) return RT_ERROR;
    status = evaluated(rt, NULL);
    for (size_t k = 0; k < n && status == RT_OK; k++) f[k] = rt->x[hybrid_info.slope_slots[k]];
    return status;
}

RtStatus me_indicators(Runtime *rt, const char *call, double *g, size_t n)
{
    if (!counted(rt, call, n, hybrid_info.n_margins)) return RT_ERROR;
    return evaluated(rt, g);
}

RtStatus me_update(Runtime *rt, ExchangeEvent *event)
{
    StepPoint at = here(rt);
    RtStatus status;
    memcpy(rt->x_new, rt->x, (size_t)hybrid_info.n_z * sizeof(double));
    status = tell(rt, exchange_event(&at, rt->x_new, event), &at);
    if (status > RT_DISCARD) {
        rt->s.phase = PHASE_ERROR;
        return status;
    }
    memcpy(rt->x, rt->x_new, (size_t)hybrid_info.n_z * sizeof(double));
    moved(rt);
    return event->terminate ? RT_OK : status;
}

RtStatus me_step_completed(Runtime *rt, ExchangeEvent *event)
{
    StepPoint at = here(rt);
    RtStatus status;
    memcpy(rt->x_new, rt->x, (size_t)hybrid_info.n_z * sizeof(double));
    event->wanted = event->terminate = 0;
    status = tell(rt, exchange_step_completed(&at, rt->x_new, event), &at);
    if (status > RT_DISCARD) {
        rt->s.phase = PHASE_ERROR;
        return status;
    }
    /* Warnings are told once. */
    for (int k = 0; k < hybrid_info.n_actions; k++)
        rt->x[hybrid_info.warned_slot + k] = rt->x_new[hybrid_info.warned_slot + k];
    return event->terminate ? RT_OK : status;
}

RtStatus me_do_step(Runtime *rt, double point, double size, StepEnd *end)
{
    RtStatus status = rt_do_step(rt, point, size);
    double reached = rt->x_new[hybrid_info.end_slot];
    end->terminated = status == RT_DISCARD;
    end->early = 0;
    if (end->terminated) {
        /* A regular end: what the step has come to stands. */
        memcpy(rt->x, rt->x_new, (size_t)hybrid_info.n_z * sizeof(double));
        rt->x[hybrid_info.ended_slot] = 1;
        rt->s.time = rt->s.last_success = reached;
        moved(rt);
    } else if (status < RT_DISCARD && me_use(rt) == USE_EARLY_RETURN && reached < rt->s.time) {
        end->early = 1;
        rt->s.time = rt->s.last_success = reached;
    }
    return status;
}
