/* One communication step: inputs taken over, internal steps, events, assertions. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "integrate.h"

/* Events closer than NEAR communication steps are in close succession; so many of them are chattering. */
static const double NEAR = 1e-8;
enum { MAX_NEAR_EVENTS = 100, MAX_LOCATIONS = 20 };

/* So many internal steps in a row, repeated ones counted too, must come LEAST_PROGRESS of the communication
 * step further: 4e7 of them may make a communication step, some seconds at 0.1 us each for a model of one
 * state. A step is stable up to 3.3 time constants, and at worst half of them are repeated: what is stiff
 * gets through down to time constants of 1.5e-8 communication steps, and with no more than WINDOW internal
 * steps in a communication step always. Where a derivative grows without bound or is as steep as a jump, if
 * not quite one, steps get as short as a state takes for 1e-13 of its nominal value. A communication step
 * would last for minutes to years then; it ends after two windows at most. */
static const double LEAST_PROGRESS = 0.05;
enum { WINDOW = 2000000 };

/* Where a derivative jumps without an event and the solution cannot leave the jump, as x' = -sign(x) cannot
 * leave 0, error control would keep x within 1e-13 of its nominal value, a step of 1e-12 s or so after the
 * other. Internal steps there are JUMP_SHARE of the communication step, whatever their error, which is at
 * most what the jump makes in one; it is told once. Looked for where all of SOME internal steps in a row,
 * repeated ones counted too, were shorter than an eighth of that: a jump that is crossed takes fewer. */
static const double JUMP_SHARE = 1.0 / 4096;
enum { SOME = 997 }; /* prime: of steps that repeat a pattern, other ones are looked at each time */
/* s.started from when a jump was told on; elsewhere any value but 0 means the same. */
enum { JUMP_TOLD = 2 };

enum { NO_LEVEL = 1000, EVENT = -1 };

static void copy(double *to, const double *from, int n)
{
    if (n) memcpy(to, from, (size_t)n * sizeof *to);
}

static int differ(const double *a, const double *b, int n)
{
    return n && memcmp(a, b, (size_t)n * sizeof *a) != 0;
}

/* Modes and pieces change at the present time: at an event (`inputs` is EVENT), or at a communication
 * point, where inputs may have changed (as delay_open_pieces takes them). */
static int discontinuity(Runtime *rt, int inputs)
{
    int switched;
    rt->crossed_level = NO_LEVEL;
    for (int j = 0; j < model_info.n_d; j++) rt->crossed[j] = 0;
    if (rt_settle(rt)) return 1;
    switched = differ(rt->m, rt->m_done, model_info.n_m);
    if (switched) {
        rt_log_event(rt, "event at t = %.12g s: relations changed", rt->s.time);
        copy(rt->m_done, rt->m, model_info.n_m);
    }
    delay_open_pieces(rt, inputs == EVENT ? 0 : inputs, switched);
    rt->s.first_stage_valid = 0;
    rt->s.modes_stale = 0;
    if (inputs != EVENT) return 0;

    rt->s.near_events = rt->s.time - rt->s.last_event < NEAR * rt->step_size ? rt->s.near_events + 1 : 0;
    rt->s.last_event = rt->s.time;
    if (rt->s.near_events < MAX_NEAR_EVENTS) return 0;
    return rt_fail(rt, RT_ERROR, "chattering at t = %.9g s: %d events within less than %.3g s of each other",
                   rt->s.time, MAX_NEAR_EVENTS, NEAR * rt->step_size);
}

/* Where an internal step must end at the latest: the target, or the first propagated jump. A delay time
 * that varies is not predicted; its jumps are located like events. */
static double landing(const Runtime *rt, double target)
{
    double first = target;
    for (int j = 0; j < model_info.n_d; j++) {
        const Delay *q = &rt->delays[j];
        double arrival = q->end + rt->lag[j];
        if (q->lag_before >= 0 && q->lag_before != rt->lag[j]) continue;
        if (arrival < first && arrival > rt->t0) first = arrival;
    }
    /* What is left before the target must be a step, not a rounding error. */
    return target - first <= rt_event_tolerance(rt) / 4 ? target : first;
}

static RtStatus accept(Runtime *rt, double end, int event)
{
    RtStatus status = RT_OK;
    double *held = rt->u;
    copy(rt->x, rt->x_new, model_info.n_x);
    rt->s.time = end;
    rt->stepping = 0;
    if (model_info.n_d && delay_append(rt, rt->t0, end)) return rt->trouble;
    for (int j = 0; j < model_info.n_d; j++) rt->delays[j].lag_before = rt->lag[j];
    if (!event) {
        copy(rt->operand, rt->operand_stage, model_info.n_d);
        copy(rt->lag, rt->lag_stage, model_info.n_d);
        copy(rt->k1, rt->k[6], model_info.n_x);
        rt->s.first_stage_valid = 1;
    }
    /* Modes and assertions belong to the inputs of this instant. */
    if (rt->s.slopes) {
        copy(rt->u_now, rt_inputs(rt, end), model_info.n_u);
        rt->u = rt->u_now;
    }
    if (event && discontinuity(rt, EVENT)) status = rt->trouble;
    if (status == RT_OK) status = rt_check_assertions(rt);
    rt->u = held;
    if (status < RT_DISCARD) rt->s.last_success = end;
    return status;
}

/* Fail for want of progress since the time `since`, with what longer steps than `h`, the one to come, fail
 * for. Not to be discarded: with shorter and shorter communication steps a master would get nowhere, too. */
static RtStatus stuck(Runtime *rt, double since, double h, double stop)
{
    char reason[200] = "events cut them short";
    double factor;
    int event;
    if (rt_attempt(rt, fmin(rt->t0 + 10 * h, stop), &factor, &event) == STEP_REJECTED)
        snprintf(reason, sizeof reason, "in one of %.3g s %.150s", rt->h, rt->trouble_text);
    rt_fail(rt, RT_ERROR,
            "no progress at t = %.9g s: the last %d internal steps took %.3g s together, less than %g of the "
            "communication step of %.3g s; %s. A derivative jumps or grows without bound there, or is too "
            "stiff: keep roots and divisions away from zero, write a jump as an event (if, without noEvent), "
            "give it a finite slope, or take shorter communication steps if it is but stiff",
            rt->t0, (int)WINDOW, rt->t0 - since, LEAST_PROGRESS, rt->step_size, reason);
    return rt->trouble;
}

/* Whether the error of steps from t0 falls as their length does, from `longest` down to some tolerances. It
 * falls so across a jump, from which the stages' derivatives differ by as much however short the step is;
 * with its sixth power where all is smooth, if stiff. The first is told from the second. */
static int jumps(Runtime *rt, double longest)
{
    double h = longest, before = rt_step_error(rt, rt->t0 + h);
    int halvings = 0;
    for (;; halvings++) {
        double error = rt_step_error(rt, rt->t0 + (h /= 2));
        if (error <= 8) break; /* the jump may lie beyond */
        if (!(error > before / 4 && error < 0.75 * before)) return 0;
        before = error;
    }
    return halvings >= 1;
}

/* Log once that a step of `h` at t0 was taken in spite of its error. */
static RtStatus tell_jump(Runtime *rt, double h)
{
    if (rt->s.started == JUMP_TOLD) return RT_OK;
    rt->s.started = JUMP_TOLD;
    rt_log(rt, RT_WARNING,
           "a derivative jumps without an event at t = %.9g s, and the solution stays at the jump (told once): "
           "internal steps of %.3g s, 1/%g of the communication step, are taken there although %s; what the "
           "jump makes in one of them is the error. Write the jump as an event (if, without noEvent), give it a "
           "finite slope, or take shorter communication steps",
           rt->t0, h, 1 / JUMP_SHARE, rt->trouble_text);
    return RT_WARNING;
}

static RtStatus integrate(Runtime *rt, double target)
{
    RtStatus worst = RT_OK;
    double since = rt->s.time, some_longest = 0, jump_step = JUMP_SHARE * rt->step_size;
    int misses = 0, tries = 0, some = 0, at_jump = 0;
    while (rt->s.time < target) {
        double stop, h, factor, floor, allowed = 1;
        int whole, event, cut = 0, located = 0;
        RtStatus status;
        rt->t0 = rt->s.time;
        rt->h = target - rt->t0;
        rt->stepping = 0;
        if (!rt->s.first_stage_valid) {
            if (rt_field(rt, rt->t0, rt->x, rt->k1, rt->operand, rt->lag)) return rt->trouble;
            rt->s.first_stage_valid = 1;
        }
        stop = landing(rt, target);
        if (some >= SOME) {
            double longest = fmin(jump_step, stop - rt->t0);
            if (!at_jump && some_longest < longest / 8 && jumps(rt, longest)) {
                at_jump = 1;
                rt->s.step_memory = longest;
            }
            some = 0;
            some_longest = 0;
        }
        h = stop - rt->t0;
        whole = h <= rt->s.step_memory;
        if (!whole) h = h < 2 * rt->s.step_memory ? h / 2 : rt->s.step_memory;
        floor = fmax(16 * DBL_EPSILON * fabs(target), 1e-13 * rt->step_size);
        for (;;) {
            double end = whole ? stop : rt->t0 + h;
            Verdict verdict;
            if (end > stop) end = stop;
            if (++tries > WINDOW) {
                if (rt->t0 - since < LEAST_PROGRESS * rt->step_size) return stuck(rt, since, h, stop);
                since = rt->t0;
                tries = 1;
            }
            some++;
            verdict = rt_attempt_within(rt, end, allowed, &factor, &event);
            if (verdict == STEP_REJECTED && at_jump) {
                double tried = rt->h, error = rt_step_error(rt, end);
                if (error > 1 && isfinite(error) && allowed == 1) {
                    double eighth;
                    whole = cut = 0;
                    if (tried > 1.5 * jump_step) { /* rounding is in what was tried */
                        h = rt->s.step_memory = fmax(factor * tried, jump_step);
                        continue;
                    }
                    eighth = rt_step_error(rt, rt->t0 + tried / 8);
                    if (eighth <= 1 && tried / 8 > floor) {
                        /* Up to the jump error control holds. */
                        h = tried / 8;
                        continue;
                    }
                    if (eighth > 1 && error < 64 * eighth) {
                        h = tried;
                        allowed = INFINITY;
                        status = tell_jump(rt, tried);
                        if (status > worst) worst = status;
                        continue;
                    }
                }
                at_jump = 0;
                allowed = 1;
                rt->h = tried;
            }
            if (verdict == STEP_ACCEPTED) {
                /* A step cut short by a stop says only that the remembered size is not too large. */
                double next = rt->h * factor;
                if (!cut && (!whole || next > rt->s.step_memory)) rt->s.step_memory = next;
                misses = event || !cut ? 0 : misses + 1;
                some_longest = fmax(some_longest, rt->h);
                status = accept(rt, end, event);
                if (status > worst) worst = status;
                if (status >= RT_DISCARD) return status;
                break;
            }
            if (verdict == STEP_EVENT) {
                /* After a miss by rounding errors time still has to pass. */
                double least = 4 * DBL_EPSILON * fmax(fabs(rt->t0), rt->step_size) * pow(2, misses);
                /* Location converges at once where everything is smooth; elsewhere halving does. */
                double shorter = (++located > MAX_LOCATIONS ? factor / 2 : factor) * rt->h;
                h = fmax(shorter, least);
                if (fmin(rt->t0 + h, stop) == end) {
                    /* The event lies within the least time: the same step again would have it again. */
                    h = shorter;
                    misses = 0;
                }
                cut = 1;
            } else {
                h = factor * rt->h;
                if (h < floor && verdict == STEP_SHORTEN) h = floor;
                if (h < floor) {
                    char reason[sizeof rt->trouble_text];
                    memcpy(reason, rt->trouble_text, sizeof reason);
                    rt_fail(rt, rt->trouble, "the internal step size fell below %.3g s at t = %.9g s: %.300s",
                            floor, rt->t0, reason);
                    return rt->trouble;
                }
                rt->s.step_memory = h;
                cut = 0;
            }
            whole = 0;
        }
    }
    return worst;
}

static int legal_step(Runtime *rt, double point, double size)
{
    /* A master that sums its steps up may be off by rounding errors. */
    double close = 1e-3 * fabs(size) + 16 * DBL_EPSILON * fabs(rt->s.time);
    if (!(size > 0) || !isfinite(size) || !isfinite(point))
        return !rt_fail(
            rt, RT_ERROR,
            "communication point %.9g s, step size %.9g s: both must be finite, the step size above 0 s",
            point, size);
    if (fabs(point - rt->s.time) > close)
        return !rt_fail(rt, RT_ERROR, "communication point %.17g s is not the instance's time %.17g s", point,
                        rt->s.time);
    if (!(point + size > rt->s.time))
        return !rt_fail(rt, RT_ERROR, "step size %.9g s is lost in rounding at t = %.9g s", size, rt->s.time);
    if (rt->s.stop_defined && point + size > rt->s.stop_time + 1e-9 * fmax(fabs(rt->s.stop_time), size))
        return !rt_fail(rt, RT_ERROR, "step from %.9g s to %.9g s passes the stop time %.9g s", point,
                        point + size, rt->s.stop_time);
    return 1;
}

/* Step from the present time to point + size: the sum is taken anew each time, so the grid does not drift. */
RtStatus rt_do_step(Runtime *rt, double point, double size)
{
    double target = point + size;
    RtStatus status = RT_OK;
    int n_u = model_info.n_u, changed;
    /* Nothing has happened yet: the instance can go on after a refusal. */
    if (!legal_step(rt, point, size)) return rt_report(rt, "DoStep");
    rt->step_start = rt->s.time;
    rt->step_size = target - rt->s.time;
    rt->s.last_success = rt->s.time;
    changed = (differ(rt->u, rt->u_before, n_u) ? 1 : 0) | (rt->s.slopes || rt->s.slopes_before ? 2 : 0);
    if (changed || rt->s.modes_stale) {
        copy(rt->m, rt->m_done, model_info.n_m);
        if (discontinuity(rt, changed)) {
            rt->s.phase = PHASE_ERROR;
            return rt_report(rt, "DoStep");
        }
    }
    if (model_info.n_x || model_info.n_d) {
        if (!(rt->s.step_memory > 0)) rt->s.step_memory = rt->step_size;
        status = integrate(rt, target);
    }
    rt->stepping = 0;
    rt->s.outputs_stale = rt->s.derivatives_stale = 1;
    if (rt->s.slopes) {
        copy(rt->u_now, rt_inputs(rt, status < RT_DISCARD ? target : rt->s.time), n_u);
        copy(rt->u, rt->u_now, n_u);
        memset(rt->u1, 0, (size_t)n_u * sizeof(double));
        memset(rt->u2, 0, (size_t)n_u * sizeof(double));
    }
    rt->s.slopes_before = rt->s.slopes;
    rt->s.slopes = 0;
    copy(rt->u_before, rt->u, n_u);
    if (!model_info.n_x && !model_info.n_d) {
        /* Nothing is remembered but the modes: what happens between the points leaves no trace. */
        rt->s.time = target;
        if (model_info.n_m && discontinuity(rt, 0)) status = rt->trouble;
        if (status < RT_DISCARD) status = rt_check_assertions(rt);
        if (status < RT_DISCARD) rt->s.last_success = target;
    }
    if (status >= RT_DISCARD) {
        rt->s.phase = status == RT_DISCARD ? PHASE_STEP_DISCARDED : PHASE_ERROR;
        return rt_report(rt, "DoStep");
    }
    return status;
}
