/* The master: initial values, and communication steps by Jacobi or Gauss-Seidel.
 *
 * Order and arithmetic are those of orchestrator/system/initialisation.py, running_connections.py and
 * orchestrator/simulation/native/kernel.py, so that the signals are the same to the bit.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "system.h"

/* Of algebraic loops at initialisation, as in initialisation.py and fixed_point.py. */
static const double TOLERANCE = 1e-12, DIFFERENCE = 1.4901161193847656e-08;
enum { ITERATIONS = 50, MOST_READS = 16 };

/* Put the value of a path into its place; `commit`: the instant is accepted, effects remember it. */
static void path_evaluate(Container *c, const Path *path, double time, int commit)
{
    double total = 0.0, x[1 + MOST_READS];
    for (int i = 0; i < path->n_legs; i++) {
        const Feed *leg = &c->legs[path->first_leg + i];
        double term = c->signals[leg->source];
        if (leg->gain != 1.0 || leg->offset != 0.0) term = leg->gain * term + leg->offset;
        total = i == 0 ? term : total + term;
    }
    for (int i = 0; i < path->n_links && isfinite(total); i++) {
        const Link *link = &c->links[path->first_link + i];
        x[0] = total;
        for (int k = 0; k < link->n_reads; k++) x[1 + k] = c->signals[link->reads[k]];
        total = effect_value(link, time, x, c->memory + link->first_memory, commit);
    }
    c->signals[path->place] = total;
}

static const char *name_of(const Container *c, int place)
{
    for (int i = 0; i < c->n_variables; i++)
        if (c->variables[i].kind == VARIABLE_SIGNAL && c->variables[i].place == place) return c->variables[i].name;
    for (int b = 0; b < c->n_blocks; b++)
        for (int i = 0; c->blocks[b].getting && i < c->blocks[b].n_values; i++)
            if (c->blocks[b].places[i] == place) return c->inner[c->blocks[b].instance].name;
    return "a connection";
}

static RtStatus check_finite(Container *c, int place, double time)
{
    if (isfinite(c->signals[place])) return RT_OK;
    rt_fail(&c->rt, RT_ERROR, "%s gave %g at %.9g s", name_of(c, place), c->signals[place], time);
    return RT_ERROR;
}

/* Initial values. */

static RtStatus read_one(Container *c, const Action *action)
{
    RtStatus status = inner_get(c, &action->at, &c->signals[action->place]);
    return status > RT_WARNING ? status : check_finite(c, action->place, c->rt.s.start_time);
}

static RtStatus give_one(Container *c, const Action *action)
{
    double value;
    if (action->path >= 0) path_evaluate(c, &c->paths[action->path], c->rt.s.start_time, 0);
    value = c->signals[action->place];
    if (action->gain != 1.0 || action->offset != 0.0) value = action->gain * value + action->offset;
    return inner_set(c, &action->at, value);
}

/* f = F(x): what the sources of a loop give where they are taken to give x. */
static RtStatus around(Container *c, const Action *loop, const double *x, double *f)
{
    const Action *reads = loop + 1, *gives = reads + loop->n_reads;
    RtStatus status = RT_OK;
    for (int i = 0; i < loop->n_reads; i++) c->signals[reads[i].place] = x[i];
    for (int i = 0; i < loop->n_gives && status <= RT_WARNING; i++) status = give_one(c, &gives[i]);
    for (int i = 0; i < loop->n_reads && status <= RT_WARNING; i++) {
        status = read_one(c, &reads[i]);
        f[i] = c->signals[reads[i].place];
    }
    return status;
}

/* Solve m y = y in place, m of n rows; 1 if it is singular. */
static int eliminate(double *m, double *y, int n)
{
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(m[i * n + k]) > fabs(m[pivot * n + k])) pivot = i;
        if (!(fabs(m[pivot * n + k]) > 0)) return 1;
        for (int j = 0; j < n; j++) {
            double kept = m[k * n + j];
            m[k * n + j] = m[pivot * n + j];
            m[pivot * n + j] = kept;
        }
        double kept = y[k];
        y[k] = y[pivot];
        y[pivot] = kept;
        for (int i = k + 1; i < n; i++) {
            double factor = m[i * n + k] / m[k * n + k];
            for (int j = k; j < n; j++) m[i * n + j] -= factor * m[k * n + j];
            y[i] -= factor * y[k];
        }
    }
    for (int k = n - 1; k >= 0; k--) {
        for (int j = k + 1; j < n; j++) y[k] -= m[k * n + j] * y[j];
        y[k] /= m[k * n + k];
    }
    return 0;
}

/* The slope of F(x) - x by differences, and Newton's step. */
static RtStatus newton(Container *c, const Action *loop, const double *x, const double *f, double *step,
                       double *matrix, double *moved, double *other)
{
    int n = loop->n_reads;
    for (int j = 0; j < n; j++) {
        RtStatus status;
        double size = fmax(fmax(fabs(x[j]), fabs(f[j])), loop[1 + j].gain);
        memcpy(moved, x, (size_t)n * sizeof *moved);
        moved[j] += DIFFERENCE * size;
        status = around(c, loop, moved, other);
        if (status > RT_WARNING) return status;
        for (int i = 0; i < n; i++) matrix[i * n + j] = (other[i] - f[i]) / (moved[j] - x[j]) - (i == j);
    }
    for (int i = 0; i < n; i++) step[i] = x[i] - f[i];
    if (!eliminate(matrix, step, n)) return RT_OK;
    rt_fail(&c->rt, RT_ERROR, "the algebraic loop through %s at initialisation has no single solution",
            name_of(c, loop[1].place));
    return RT_ERROR;
}

static RtStatus solve(Container *c, const Action *loop)
{
    int n = loop->n_reads, converged = 0;
    size_t length = (size_t)n;
    double *block = calloc(6 * length + length * length, sizeof(double)), best_size = INFINITY, damping = 1;
    double *x = block, *f = x + n, *best = f + n, *step = best + n, *moved = step + n, *other = moved + n;
    RtStatus status = RT_OK;
    if (!block) {
        rt_fail(&c->rt, RT_ERROR, "no memory");
        return RT_ERROR;
    }
    for (int i = 0; i < n && status <= RT_WARNING; i++) {
        status = read_one(c, &loop[1 + i]);
        x[i] = c->signals[loop[1 + i].place];
    }
    for (int iteration = 0; iteration < ITERATIONS && status <= RT_WARNING && !converged; iteration++) {
        double size = 0;
        status = around(c, loop, x, f);
        if (status > RT_WARNING) break;
        converged = 1;
        for (int i = 0; i < n; i++) {
            double nominal = loop[1 + i].gain, gap = fabs(f[i] - x[i]);
            if (!(gap / fmax(fabs(f[i]), nominal) <= TOLERANCE)) converged = 0;
            size = fmax(size, gap / nominal);
        }
        if (converged) break;
        if (size < best_size) {
            memcpy(best, x, length * sizeof *x);
            best_size = size;
            damping = 1;
            status = newton(c, loop, x, f, step, other + n, moved, other);
        } else {
            damping *= 0.5; /* a step that makes it worse is halved */
        }
        for (int i = 0; i < n; i++) x[i] = best[i] + damping * step[i];
    }
    free(block);
    if (status > RT_WARNING || converged) return status;
    rt_fail(&c->rt, RT_ERROR, "the algebraic loop through %s at initialisation does not converge",
            name_of(c, loop[1].place));
    return RT_ERROR;
}

/* Set every connected input to what its source gives. */
RtStatus pass_initial_values(Container *c)
{
    RtStatus status = RT_OK;
    for (int i = 0; i < c->n_actions && status <= RT_WARNING; i++) {
        const Action *action = &c->actions[i];
        if (action->kind == ACTION_LOOP) {
            status = solve(c, action);
            i += action->n_reads + action->n_gives;
        } else {
            status = action->kind == ACTION_READ ? read_one(c, action) : give_one(c, action);
        }
    }
    if (status <= RT_WARNING) *c->stale = 0;
    return status;
}

/* All outputs into the signals. */
RtStatus read_signals(Container *c)
{
    RtStatus status = RT_OK;
    for (int i = 0; i < c->n_blocks && status <= RT_WARNING; i++)
        if (c->blocks[i].getting) status = inner_move(c, &c->blocks[i]);
    return status;
}

/* All signals belong to an instant that is accepted: effects remember it. */
RtStatus accept_signals(Container *c, double time)
{
    for (int i = 0; i < c->n_paths; i++) path_evaluate(c, &c->paths[i], time, 1);
    for (int i = 0; i < c->n_signals; i++)
        if (check_finite(c, i, time) > RT_WARNING) return RT_ERROR;
    return RT_OK;
}

/* Steps. */

/* Quotients of whole numbers are rounded once, so that no sum of steps runs away. */
double time_at(const Container *c, long long index)
{
    double start = (double)c->begin / (double)c->denominator;
    if (c->rt.s.start_time == start) return (double)(c->begin + index * c->stride) / (double)c->denominator;
    return c->rt.s.start_time + (double)(index * c->stride) / (double)c->denominator;
}

static void transfer(Container *c, const Inner *inner)
{
    for (int i = inner->first_input; i < inner->first_input + inner->n_inputs; i++) {
        const Feed *feed = &c->feeds[i];
        if (feed->source < 0) c->inputs[i] = c->externals[-1 - feed->source];
        else if (inner->converts) c->inputs[i] = c->signals[feed->source] * feed->gain + feed->offset;
        else c->inputs[i] = c->signals[feed->source];
    }
}

static void follow(Container *c, const Inner *inner, double end)
{
    for (int i = 0; i < inner->n_after; i++)
        path_evaluate(c, &c->paths[c->after[inner->first_after + i]], end, 0);
}

static RtStatus advance(Container *c, Inner *inner, double time)
{
    RtStatus status = RT_OK, worst = RT_OK;
    for (int i = 0; i < inner->n_sets && status <= RT_WARNING; i++)
        status = inner_move(c, &c->blocks[inner->first_set + i]);
    if (status > RT_WARNING) return status;
    if (inner->every > 1) {
        status = inner_step(inner, c->begun[inner - c->inner], inner->every * c->step_size);
    } else {
        double size = inner->parts == 1 ? c->step_size : c->step_size / inner->parts;
        for (int part = 0; part < inner->parts && status <= RT_WARNING; part++) {
            double own = part ? time + c->step_size * ((double)part / inner->parts) : time;
            status = inner_step(inner, own, size);
            if (status > worst) worst = status;
        }
    }
    for (int i = 0; i < inner->n_gets && status <= RT_WARNING; i++)
        status = inner_move(c, &c->blocks[inner->first_get + i]);
    return status > worst ? status : worst;
}

/* One communication step of the system. */
RtStatus take_step(Container *c)
{
    long long index = (long long)*c->index;
    double time = time_at(c, index), end = time + c->step_size;
    RtStatus worst = RT_OK;
    for (int i = 0; i < c->n_inner && !c->late; i++)
        if (index % c->inner[i].every == 0) transfer(c, &c->inner[i]);
    for (int i = 0; i < c->n_order; i++) {
        Inner *inner = &c->inner[c->order[i]];
        RtStatus status;
        if (index % inner->every == 0) c->begun[c->order[i]] = time;
        if ((index + 1) % inner->every != 0) { /* it keeps its outputs until its own step ends */
            if (c->late) follow(c, inner, end);
            continue;
        }
        if (c->late) transfer(c, inner);
        status = advance(c, inner, time);
        if (status > RT_WARNING) return status;
        if (status > worst) worst = status;
        if (c->late) follow(c, inner, end);
    }
    if (accept_signals(c, end) > RT_WARNING) return RT_ERROR;
    *c->index = (double)(index + 1);
    return worst;
}
