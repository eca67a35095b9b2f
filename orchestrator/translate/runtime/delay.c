/* Delay operators d(t) = y(t - lag): the history of each operand y and its look-up.
 *
 * The history is a ring of polynomial segments, one per internal step. Where y or one of its first four
 * derivatives jumps, a new piece begins; values on both sides of a jump are kept, since every segment
 * owns both of its ends. Which piece an operator reads is a discrete state like a relation's mode: the
 * integrator holds it during an internal step and stops where t - lag reaches the end of the piece, so
 * that no step integrates across a propagated jump (Bellen, Zennaro: Numerical Methods for Delay
 * Differential Equations, 2003, ch. 4). This holds for constant and for varying delay times alike.
 * Before the start time y has its value at the start (Modelica Language Specification 3.6, 3.7.4.1).
 */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "runtime.h"

/* A jump in the fifth derivative no longer lowers the order of the integrator. */
enum { HIGHEST_LEVEL = 4, FIRST_CAPACITY = 64 };

/* Times closer than this are one instant: t - lag carries the rounding errors of both. */
static double slack(double time, double lag)
{
    return 8 * DBL_EPSILON * (fabs(time) + lag);
}

static Segment *segment(const Runtime *rt, int j, long long n)
{
    return &rt->rings[j][n & (rt->capacities[j] - 1)];
}

/* The polynomial's argument; beyond its segment it is followed for a while only, since a short segment
 * says nothing about what lies many of its lengths away. */
static double place(double time, double begin, double length)
{
    double theta = (time - begin) / length;
    return theta < -1 ? -1 : theta > 2 ? 2 : theta;
}

static double polynomial(const double *c, double theta)
{
    return c[0] + theta * (c[1] + theta * (c[2] + theta * (c[3] + theta * c[4])));
}

/* Polynomial through the values at theta = 0, 1/4, 1/2, 3/4, 1 (Newton's forward differences). */
void delay_polynomial(const double *y, double *c)
{
    double d1 = y[1] - y[0];
    double d2 = y[2] - 2 * y[1] + y[0];
    double d3 = (y[3] - y[0]) - 3 * (y[2] - y[1]);
    double d4 = (y[4] + y[0]) - 4 * (y[3] + y[1]) + 6 * y[2];
    c[0] = y[0];
    c[1] = 4 * (d1 - d2 / 2 + d3 / 3 - d4 / 4);
    c[2] = 16 * (d2 / 2 - d3 / 2 + 11 * d4 / 24);
    c[3] = 64 * (d3 / 6 - d4 / 4);
    c[4] = 256 * (d4 / 24);
}

/* Move the operator to the piece that holds `time` and lies to the right if a jump is there. */
static void select_piece(Runtime *rt, int j, double time, double tolerance)
{
    Delay *q = &rt->delays[j];
    double reach = time + tolerance;
    if (q->begin <= reach && q->end > reach) return;

    long long n = q->cursor;
    if (n < q->first) n = q->first;
    if (n > q->next - 1) n = q->next - 1;
    while (n > q->first && segment(rt, j, n)->begin > reach) n--;
    while (n + 1 < q->next && segment(rt, j, n + 1)->begin <= reach) n++;

    long long written = segment(rt, j, q->next - 1)->piece;
    long long piece = segment(rt, j, n)->piece;
    int unwritten = q->newest > written && q->newest_begin <= reach;
    if (unwritten) piece = q->newest;

    if (piece != q->piece) rt->crossed[j] = 1;
    long long low = piece < q->piece ? piece : q->piece, high = piece < q->piece ? q->piece : piece;
    if (high > low && q->newest == high && q->newest > written && q->newest_level < rt->crossed_level)
        rt->crossed_level = q->newest_level;
    for (long long i = n; i >= q->first && segment(rt, j, i)->piece > low; i--)
        if (segment(rt, j, i)->level < rt->crossed_level) rt->crossed_level = segment(rt, j, i)->level;
    for (long long i = n + 1; i < q->next && segment(rt, j, i)->piece <= high; i++)
        if (segment(rt, j, i)->piece > low && segment(rt, j, i)->level < rt->crossed_level)
            rt->crossed_level = segment(rt, j, i)->level;

    q->cursor = n;
    q->piece = piece;
    if (unwritten) {
        q->begin = q->newest_begin;
        q->end = INFINITY;
        return;
    }
    long long b = n, e = n + 1;
    while (b > q->first && segment(rt, j, b - 1)->piece == piece) b--;
    while (e < q->next && segment(rt, j, e)->piece == piece) e++;
    /* Piece 0 is the time before the start; what was dropped out of reach bounds nothing either. */
    q->begin = b == q->first ? -INFINITY : segment(rt, j, b)->begin;
    q->end = e < q->next ? segment(rt, j, e)->begin : q->newest > written ? q->newest_begin : INFINITY;
}

/* An operator without delay reads the present. */
static void read_newest(Delay *q)
{
    q->piece = q->newest;
    q->begin = q->newest_begin;
    q->end = INFINITY;
}

/* Segment of the piece being read at `time`, or NULL if that lies in the internal step being tried. */
static const Segment *find(Runtime *rt, int j, double time)
{
    Delay *q = &rt->delays[j];
    long long written = segment(rt, j, q->next - 1)->piece;
    if (q->piece == q->newest && (q->newest > written || (rt->stepping && time > rt->t0))) return NULL;
    long long n = q->cursor;
    if (n < q->first) n = q->first;
    if (n > q->next - 1) n = q->next - 1;
    for (;;) {
        const Segment *here = segment(rt, j, n);
        if (here->piece > q->piece) {
            if (n == q->first) break;
            n--;
        } else if (here->piece < q->piece) {
            if (n + 1 == q->next) break;
            n++;
        } else if (here->begin > time && n > q->first && segment(rt, j, n - 1)->piece == q->piece) {
            n--;
        } else if (n + 1 < q->next && segment(rt, j, n + 1)->piece == q->piece &&
                   segment(rt, j, n + 1)->begin <= time) {
            n++;
        } else {
            break;
        }
    }
    q->cursor = n;
    return segment(rt, j, n);
}

static double look_up(Runtime *rt, int j, double time, double operand)
{
    const Segment *found = find(rt, j, time);
    if (found) return polynomial(found->c, place(time, found->begin, found->end - found->begin));
    if (!rt->stepping) return operand;
    rt->overlapped = 1;
    return polynomial(rt->guess + 5 * j, place(time, rt->t0, rt->h));
}

/* Values, operands and delay times of all operators; returns 1 for a delay time that cannot be.
 *
 * Entry j of the model's function depends on d[k] with k < j only, so repeating it until d no longer
 * changes gives the one solution, after n_d passes at the latest. */
int delay_values(Runtime *rt, ModelPoint *at, double *d, double *operand, double *lag, ReadMode mode)
{
    int n = model_info.n_d;
    int bad = -1;
    at->d = d;
    for (int pass = 0; pass < n; pass++) {
        int changed = 0;
        model_delays(at, operand, lag);
        bad = -1;
        for (int j = 0; j < n; j++) {
            double value;
            /* A delay time that vanishes is computed with rounding errors of either sign. */
            if (lag[j] < 0 && lag[j] >= -slack(at->time, 0)) lag[j] = 0;
            if (!(lag[j] >= 0) || (rt->s.started && !(lag[j] <= rt->delays[j].maximum * (1 + 1e-9)))) {
                if (bad < 0) bad = j;
                value = operand[j];
            } else if (!rt->s.started || lag[j] <= slack(at->time, lag[j])) {
                value = operand[j];
                if (mode == READ_SELECT && rt->s.started) read_newest(&rt->delays[j]);
            } else {
                double time = at->time - lag[j];
                if (mode == READ_SELECT) select_piece(rt, j, time, slack(at->time, lag[j]));
                value = look_up(rt, j, time, operand[j]);
            }
            if (memcmp(&value, &d[j], sizeof value) != 0) changed = 1;
            d[j] = value;
        }
        if (!changed) break;
    }
    if (bad < 0) return 0;
    if (lag[bad] > 0)
        return rt_fail(rt, RT_ERROR,
                       "delay operator %d at t = %.9g s: delay time %.9g s exceeds its maximum %.9g s",
                       bad + 1, at->time, lag[bad], rt->delays[bad].maximum);
    return rt_fail(rt, RT_ERROR,
                   "delay operator %d at t = %.9g s: delay time is %.9g s; it must be 0 s or more", bad + 1,
                   at->time, lag[bad]);
}

/* Whether some operator has left the piece it reads. */
int delay_crossed(const Runtime *rt, double time, const double *lag)
{
    for (int j = 0; j < model_info.n_d; j++) {
        const Delay *q = &rt->delays[j];
        double reach = time - lag[j] + slack(time, lag[j]);
        if (q->end <= reach || q->begin > reach) return 1;
    }
    return 0;
}

/* Time derivative of operator j's operand at a past time [1/s]. */
double delay_slope(Runtime *rt, int j, double time)
{
    const Segment *found = find(rt, j, time);
    if (!found) return 0;
    double length = found->end - found->begin, theta = place(time, found->begin, length);
    const double *c = found->c;
    return (c[1] + theta * (2 * c[2] + theta * (3 * c[3] + theta * 4 * c[4]))) / length;
}

static int push(Runtime *rt, int j, const Segment *entry)
{
    Delay *q = &rt->delays[j];
    if (q->next - q->first >= rt->capacities[j]) {
        long long capacity = rt->capacities[j] ? 2 * rt->capacities[j] : FIRST_CAPACITY;
        Segment *ring = malloc((size_t)capacity * sizeof *ring);
        if (!ring)
            return rt_fail(rt, RT_ERROR, "delay operator %d: no memory for %lld entries of history", j + 1,
                           capacity);
        for (long long n = q->first; n < q->next; n++) ring[n & (capacity - 1)] = *segment(rt, j, n);
        free(rt->rings[j]);
        rt->rings[j] = ring;
        rt->capacities[j] = capacity;
    }
    *segment(rt, j, q->next++) = *entry;
    return 0;
}

/* Begin the histories at the end of initialisation, with the operands of now. */
int delay_start(Runtime *rt)
{
    double *maximum = rt->lag_stage;
    if (model_info.n_d) model_delay_maxima(rt->p, maximum);
    for (int j = 0; j < model_info.n_d; j++) {
        Delay *q = &rt->delays[j];
        memset(q, 0, sizeof *q);
        if (!(maximum[j] >= 0))
            return rt_fail(rt, RT_ERROR,
                           "delay operator %d: longest delay time is %.9g s; it must be 0 s or more", j + 1,
                           maximum[j]);
        q->maximum = maximum[j];
        q->last = rt->operand[j];
        q->scale = fabs(rt->operand[j]);
        q->begin = -INFINITY;
        q->lag_before = -1;
        /* The length means nothing: the polynomial is constant. */
        Segment before = {rt->s.time - 1, rt->s.time, {rt->operand[j], 0, 0, 0, 0}, 0, 0};
        if (push(rt, j, &before)) return 1;
        q->newest = 1;
        q->newest_level = 1;
        q->newest_begin = q->end = rt->s.time;
    }
    rt->s.started = 1;
    return 0;
}

static void clear(double *a, int n)
{
    if (n) memset(a, 0, (size_t)n * sizeof *a);
}

/* Lower rt->levels to where a discontinuity of level `base` arrives, that of the seeds in t_u and t_d:
 * operands that depend on them directly have its level, operands that depend on a state whose derivative
 * does have one more, and so on along the chain of forward derivatives. */
static void propagate(Runtime *rt, long long base)
{
    int n_x = model_info.n_x, n_d = model_info.n_d;
    ModelPoint at = {rt->s.time, rt->x, rt->u, rt->p, rt->d, rt->m};
    ModelPoint seed = {0, rt->t_x, rt->t_u, rt->t_p, rt->t_d, NULL};
    clear(rt->t_x, n_x);
    clear(rt->t_p, model_info.n_p);
    for (; base <= HIGHEST_LEVEL; base++) {
        int any = 0;
        /* An operator without delay passes on what its operand does. */
        for (int pass = 0; pass < n_d; pass++) {
            int passed = 0;
            model_tangent(&at, &seed, rt->t_xdot, rt->t_w, rt->t_operand);
            for (int j = 0; j < n_d; j++) {
                if (rt->lag[j] > slack(rt->s.time, rt->lag[j]) || rt->t_d[j] == rt->t_operand[j]) continue;
                rt->t_d[j] = rt->t_operand[j];
                passed = 1;
            }
            if (!passed) break;
        }
        for (int j = 0; j < n_d; j++)
            if (rt->t_operand[j] != 0 && base < rt->levels[j]) rt->levels[j] = base;
        for (int i = 0; i < n_x; i++) {
            rt->t_x[i] = rt->t_xdot[i];
            if (rt->t_x[i] != 0) any = 1;
        }
        if (!any) return;
        clear(rt->t_u, model_info.n_u);
        clear(rt->t_d, n_d);
    }
}

/* Seeds of no simple ratio, so that two that act together do not cancel. */
static double seed_of(int i)
{
    return 1 + 0.6180339887498949 * (i + 1);
}

/* At a discontinuity at the present time, rt->operand being the operands from the right: open a new piece
 * of each operand that is not smooth there. The causes: inputs whose values (`inputs` & 1) or slopes
 * (`inputs` & 2) changed; modes (`switched`); operators that moved to another piece. */
void delay_open_pieces(Runtime *rt, int inputs, int switched)
{
    int n_d = model_info.n_d;
    for (int j = 0; j < n_d; j++) {
        double size = fabs(rt->operand[j]) + fabs(rt->delays[j].last);
        int jumps = !(fabs(rt->operand[j] - rt->delays[j].last) <= 4 * DBL_EPSILON * size);
        rt->levels[j] = jumps ? 0 : switched ? 1 : HIGHEST_LEVEL + 1;
    }
    for (int level = 0; level < 2; level++) {
        if (!n_d || switched || !(inputs & (level + 1))) continue;
        clear(rt->t_d, n_d);
        for (int i = 0; i < model_info.n_u; i++)
            rt->t_u[i] = level == 1 || rt->u[i] != rt->u_before[i] ? seed_of(i) : 0;
        propagate(rt, level);
    }
    if (n_d && rt->crossed_level <= HIGHEST_LEVEL && !switched) {
        clear(rt->t_u, model_info.n_u);
        for (int j = 0; j < n_d; j++) rt->t_d[j] = rt->crossed[j] ? seed_of(j) : 0;
        propagate(rt, rt->crossed_level);
    }
    for (int j = 0; j < n_d; j++) {
        Delay *q = &rt->delays[j];
        long long level = rt->levels[j];
        if (level > HIGHEST_LEVEL) continue;
        if (q->newest > segment(rt, j, q->next - 1)->piece) {
            if (level < q->newest_level) q->newest_level = level;
            continue;
        }
        if (q->piece == q->newest) q->end = rt->s.time;
        q->newest++;
        q->newest_level = level;
        q->newest_begin = rt->s.time;
        if (rt->lag[j] <= slack(rt->s.time, rt->lag[j])) read_newest(q);
    }
}

/* Add rt->guess, the operands' polynomials over an accepted internal step, and drop what no delay can
 * reach any more. */
int delay_append(Runtime *rt, double begin, double end)
{
    for (int j = 0; j < model_info.n_d; j++) {
        Delay *q = &rt->delays[j];
        const double *c = rt->guess + 5 * j, *y = rt->samples + 5 * j;
        Segment entry = {begin, end, {c[0], c[1], c[2], c[3], c[4]}, q->newest, q->newest_level};
        double oldest = end - q->maximum * (1 + 1e-9) - 2 * slack(end, q->maximum);
        while (q->next - q->first > 1 && segment(rt, j, q->first)->end < oldest) q->first++;
        if (push(rt, j, &entry)) return 1;
        q->last = y[4];
        for (int i = 0; i < 5; i++)
            if (fabs(y[i]) > q->scale) q->scale = fabs(y[i]);
    }
    return 0;
}
