/* Solver of models with events, equation blocks and constraints, behind stepmodel.h.
 *
 * Between events the states are integrated with error control, by explicit steps of order 5 as long as the
 * model is not stiff, else by RODAS (Hairer and Wanner, Solving Ordinary Differential Equations II, sections
 * IV.2 and IV.7), which is of order 4 and L-stable. Events are where a held relation changes; they are located by bisection. At an event, conditions,
 * discrete variables and reinit are repeated until nothing changes.
 */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "exchange.h"
#include "hybrid.h"
#include "runtime.h"
#include "stepmodel.h"

enum { FINE, BLOCK, STEP_SIZE, MODES, CHATTERING, DISCRETES, ACTION, MEMORY, CONSTRAINTS, HISTORY, LAG, START };
#define OUTCOME(code, index) ((code) * 1000000 + (index))

static const double TOLERANCE = 1e-9;    /* relative, per internal step */
static const double SOLVED = 1e-12;      /* relative change of an unknown in the last iteration */
static const double FINER = 0.1;         /* tolerance of explicit steps, whose errors add up more, over the other */
/* Largest eigenvalue times the step, above which no explicit step follows a solution as exactly as this. */
static const double FAST = 1.5;
static const int SIGNS = 8;              /* of stiffness, after which steps are implicit */
static const int OTHERS = 6;             /* steps in a row after which they count no longer */
static const int CALM = 20;              /* implicit steps without them, after which steps are explicit */
static const int MOST_ITERATIONS = 60;
static const int MOST_ROUNDS = 100;      /* of an event */
static const int MOST_FLIPS = 600;       /* rounds until the modes are consistent */
static const int FOLDED = 20;            /* events in close succession after which a solution has ceased */
static const double EQUAL = 1e-11;       /* sides of a relation that differ by rounding alone */
static const int STEADY = 60;            /* events in close succession after which rounding makes no more */
static const int MOST_EVENTS = 300;      /* in close succession */
enum { STAGES = 6 };
enum { MOST_LOOKS = 33 };                /* for events within an internal step, beside its beginning */

typedef struct {
    Hybrid h;
    double *c, *rise, *tick, *m;
    double *x, *xn, *f, *fx, *ft, *k[6], *dense[2], *a, *b, *spare; /* of the integration */
    double *j, *lu, *y, *r, *first, *next, *along, *kept, *scales;  /* of blocks */
    double *keep, *g; /* g: [MOST_LOOKS + 1][margins] */
    double *along_step; /* [STAGES][margins] at the begin and at the stages of a step, by time */
    double *held;     /* [states] 1: reinit has set it, and a projection leaves it */
    int *pivot, *pivot_a;
    int events;  /* in close succession */
    int may_jump; /* unknowns of equation blocks, as at an event */
    int has_kept; /* such unknowns from before */
    int pending; /* outcome of an action at an event, to be reported after it */
    int stiff;   /* whether steps are implicit */
    int signs;   /* steps that suit the other kind better */
    int others;  /* steps in a row that do not */
    int changes; /* whether a mode has changed at a stage of the step */
} Work;

static double *part(double *block, size_t *used, size_t n)
{
    double *at = block ? block + *used : NULL;
    *used += n;
    return at;
}

static size_t largest(void)
{
    size_t n = (size_t)hybrid_info.n_states;
    for (int i = 0; i < hybrid_info.n_blocks; i++)
        if ((size_t)hybrid_info.blocks[i].n > n) n = (size_t)hybrid_info.blocks[i].n;
    for (int i = 0; i < hybrid_info.n_initial_blocks; i++)
        if ((size_t)hybrid_info.initial_blocks[i].n > n) n = (size_t)hybrid_info.initial_blocks[i].n;
    if ((size_t)hybrid_info.n_constraints > n) n = (size_t)hybrid_info.n_constraints;
    return n + 1;
}

/* Number of unknowns of the equation blocks. */
static size_t unknowns(void)
{
    size_t n = 1;
    for (int i = 0; i < hybrid_info.n_blocks; i++) n += (size_t)hybrid_info.blocks[i].n;
    return n;
}

static size_t lay_out(Work *w, double *block)
{
    const HybridInfo *i = &hybrid_info;
    size_t used = 0, n = largest(), s = (size_t)i->n_states + 1, m = (size_t)i->n_constraints;
    size_t entries = i->factors ? (size_t)i->factors->n_entries : s * s;
    w->c = part(block, &used, (size_t)i->n_conditions + 1);
    w->rise = part(block, &used, (size_t)i->n_conditions + 1);
    w->tick = part(block, &used, (size_t)i->n_clocks + 1);
    w->m = part(block, &used, (size_t)i->n_modes + 1);
    w->x = part(block, &used, s);
    w->xn = part(block, &used, s);
    w->f = part(block, &used, s);
    w->fx = part(block, &used, entries > m * s ? entries : m * s);
    w->ft = part(block, &used, s);
    for (int a = 0; a < 6; a++) w->k[a] = part(block, &used, s);
    w->dense[0] = part(block, &used, s);
    w->dense[1] = part(block, &used, s);
    w->a = part(block, &used, entries > m * m ? entries : m * m);
    w->b = part(block, &used, s);
    w->spare = part(block, &used, s);
    w->held = part(block, &used, s);
    w->y = part(block, &used, n);
    w->r = part(block, &used, 2 * n);
    w->first = part(block, &used, n);
    w->next = part(block, &used, 3 * n);
    w->along = part(block, &used, n);
    w->scales = part(block, &used, (n + 2) * n);
    w->kept = part(block, &used, unknowns());
    w->j = part(block, &used, n * n);
    w->lu = part(block, &used, n * n);
    w->keep = part(block, &used, (size_t)i->n_z + 1);
    w->g = part(block, &used, (MOST_LOOKS + 1) * (size_t)i->n_margins + 1);
    w->along_step = part(block, &used, STAGES * (size_t)i->n_margins + 1);
    return used;
}

static Work *work_for(const StepPoint *at, double *z)
{
    Work *w = calloc(1, sizeof *w);
    double *block;
    size_t n = largest();
    if (!w) return NULL;
    block = calloc(lay_out(w, NULL), sizeof(double));
    w->pivot = calloc(4 * n, sizeof(int));
    if (!block || !w->pivot) {
        free(block);
        free(w->pivot);
        free(w);
        return NULL;
    }
    lay_out(w, block);
    w->pivot_a = w->pivot + 2 * n;
    w->h.t = at->time;
    w->h.u = at->u;
    w->h.p = at->p;
    w->h.z = z;
    w->h.c = w->c;
    w->h.rise = w->rise;
    w->h.tick = w->tick;
    w->h.initial = 0;
    w->h.homotopy = 1;
    return w;
}

static void free_work(Work *w)
{
    free(w->c);
    free(w->pivot);
    free(w);
}

/* Equations */

/* Powers of two by which rows and columns of a matrix [n][n] are multiplied, so that the largest entry of each is near 1
 * (Ruiz, A scaling algorithm to equilibrate both rows and columns norms in matrices, 2001). */
static void balance(const double *a, int n, double *by_row, double *by_column)
{
    for (int i = 0; i < n; i++) by_row[i] = by_column[i] = 1;
    for (int sweep = 0; sweep < 4; sweep++)
        for (int side = 0; side < 2; side++) {
            double *by = side ? by_column : by_row;
            for (int i = 0; i < n; i++) {
                double most = 0;
                for (int j = 0; j < n; j++)
                    most = fmax(most, side ? fabs(a[j * n + i]) * by_row[j] : fabs(a[i * n + j]) * by_column[j]);
                if (most > 0 && isfinite(most)) by[i] = ldexp(1, -ilogb(most));
            }
        }
}

static void swap(double *v, int i, int j)
{
    double kept = v[i];
    v[i] = v[j];
    v[j] = kept;
}

/* LU of the matrix [n][n], which is overwritten; its rank. An entry counts as zero where terms cancel: where it is small
 * beside those it comes from, whatever the units of the rest. `scratch` holds (n + 2) n numbers; NULL: pivots from one
 * column, of which only 0 counts as zero. */
static int factorise(double *a, int n, double *scratch, int *rows, int *columns)
{
    double *by_row = scratch, *by_column = scratch ? scratch + n : NULL, *terms = scratch ? scratch + 2 * n : NULL;
    for (int i = 0; i < n; i++) rows[i] = columns[i] = i;
    if (scratch) balance(a, n, by_row, by_column);
    for (int i = 0; scratch && i < n * n; i++) terms[i] = fabs(a[i]);
    for (int k = 0; k < n; k++) {
        int row = k, column = k;
        double best = 0;
        for (int i = k; i < n; i++)
            for (int j = k; j < (scratch ? n : k + 1); j++) {
                double size = fabs(a[i * n + j]);
                if (scratch) size = size > 1e-14 * terms[i * n + j] ? size * by_row[i] * by_column[j] : 0;
                if (size > best) {
                    best = size;
                    row = i;
                    column = j;
                }
            }
        if (!(best > 0) || !isfinite(best)) return k;
        if (row != k) {
            int other = rows[k];
            rows[k] = rows[row];
            rows[row] = other;
            if (scratch) swap(by_row, k, row);
            for (int j = 0; j < n; j++) {
                swap(a, k * n + j, row * n + j);
                if (scratch) swap(terms, k * n + j, row * n + j);
            }
        }
        if (column != k) {
            int other = columns[k];
            columns[k] = columns[column];
            columns[column] = other;
            swap(by_column, k, column);
            for (int i = 0; i < n; i++) {
                swap(a, i * n + k, i * n + column);
                swap(terms, i * n + k, i * n + column);
            }
        }
        for (int i = k + 1; i < n; i++) {
            double v = a[i * n + k] /= a[k * n + k];
            if (v == 0) continue;
            for (int j = k + 1; j < n; j++) a[i * n + j] -= v * a[k * n + j];
            for (int j = k + 1; scratch && j < n; j++)
                terms[i * n + j] = fmax(terms[i * n + j], fabs(v) * terms[k * n + j]);
        }
    }
    return n;
}

/* Solution of the factorised system; unknowns beyond the rank become 0. `scratch` holds n numbers. */
static void back_solve(const double *a, int n, int rank, const int *rows, const int *columns, const double *b,
                       double *x, double *scratch)
{
    for (int i = 0; i < n; i++) {
        double v = b[rows[i]];
        for (int j = 0; j < i && j < rank; j++) v -= a[i * n + j] * scratch[j];
        scratch[i] = v;
    }
    for (int i = n - 1; i >= 0; i--) {
        if (i >= rank) {
            scratch[i] = 0;
            continue;
        }
        for (int j = i + 1; j < rank; j++) scratch[i] -= a[i * n + j] * scratch[j];
        scratch[i] /= a[i * n + i];
    }
    for (int i = 0; i < n; i++) x[columns[i]] = scratch[i];
}

static double size_of(const double *r, int n)
{
    double most = 0;
    for (int i = 0; i < n; i++) {
        if (!isfinite(r[i])) return INFINITY;
        if (fabs(r[i]) > most) most = fabs(r[i]);
    }
    return most;
}

static void block_jacobian(Work *w, const HybridBlock *b, const double *r, double *j)
{
    double *z = w->h.z, *other = w->r + b->n;
    if (b->jacobian) {
        b->jacobian(&w->h, j);
        return;
    }
    for (int k = 0; k < b->n; k++) {
        double *v = &z[b->slots[k]], kept = *v, step = 1e-7 * fmax(1, fabs(kept));
        *v = kept + step;
        step = *v - kept;
        b->residuals(&w->h, other);
        *v = kept;
        for (int i = 0; i < b->n; i++) j[i * b->n + k] = (other[i] - r[i]) / step;
    }
}

/* How steps of Newton's method are shortened. NATURAL: until the correction that would follow with the same Jacobian
 * is smaller, whatever the units of equations and unknowns (Deuflhard, Newton Methods for Nonlinear Problems, 2004,
 * section 3.3). RESIDUAL: until no equation is further off than the worst one before. */
typedef enum { NATURAL, RESIDUAL, FULL_STEPS } Damping;

/* The largest entry of `y` in shares of the size of its unknown, which is at least `least`. */
static double in_shares(const double *y, const double *size, double least, int n)
{
    double most = 0;
    for (int i = 0; i < n; i++) most = fmax(most, fabs(y[i]) / fmax(least, fabs(size[i])));
    return most;
}

/* Whether a share of the correction w->y from w->j is good enough; the residuals at its end are w->r. */
static int accepted(Work *w, const HybridBlock *b, Damping damping, int rank, double share, double before, double next)
{
    int n = b->n;
    double *sizes = w->next, *y = w->next + n;
    if (damping == FULL_STEPS) return 1;
    /* At the limit of rounding the residual may grow a little. */
    if (isfinite(next) && share == 1 && in_shares(w->y, w->j, 1e-3, n) < 1e-9) return 1;
    if (damping == RESIDUAL || b->linear) return next <= before;
    if (!isfinite(next)) return 0;
    for (int i = 0; i < n; i++) {
        sizes[i] = fmax(fabs(w->j[i]), fabs(w->y[i]));
        if (sizes[i] == 0) sizes[i] = 1;
    }
    back_solve(w->lu, n, rank, w->pivot, w->pivot + n, w->r, y, y + n);
    return in_shares(y, sizes, 0, n) <= (1 - share / 2) * in_shares(w->y, sizes, 0, n);
}

enum { UNDETERMINED = 2 }; /* the equations hold, but leave unknowns free that they determined at first */

static int newton(Work *w, const HybridBlock *b, Damping damping)
{
    double *z = w->h.z, *r = w->r, norm;
    int n = b->n, *rows = w->pivot, *columns = w->pivot + n, first_rank = 0;
    b->residuals(&w->h, r);
    norm = size_of(r, n);
    for (int iteration = 0; iteration < MOST_ITERATIONS; iteration++) {
        double change = 0, share = 1, next, before = norm;
        int rank;
        if (norm == 0 && !(w->h.initial && iteration)) return 0;
        block_jacobian(w, b, r, w->lu);
        rank = factorise(w->lu, n, w->scales, rows, columns);
        if (!iteration) first_rank = rank;
        if (rank == 0) return norm == 0 ? UNDETERMINED : 1;
        back_solve(w->lu, n, rank, rows, columns, r, w->y, w->j);
        for (int i = 0; i < n; i++) {
            w->j[i] = z[b->slots[i]];
            if (!isfinite(w->y[i])) return 1;
        }
        for (;; share /= 4) {
            for (int i = 0; i < n; i++) z[b->slots[i]] = w->j[i] - share * w->y[i];
            b->residuals(&w->h, r);
            next = size_of(r, n);
            if (accepted(w, b, damping, rank, share, before, next)) break;
            if (share < 1e-6) {
                if (damping == NATURAL) return 1;
                break;
            }
        }
        norm = next;
        if (!isfinite(norm)) return 1;
        for (int i = 0; i < n; i++) {
            /* What is small because the step is shortened says nothing. */
            double one = fabs(w->y[i]) / fmax(1e-3, fabs(z[b->slots[i]]));
            if (one > change) change = one;
        }
        if (rank < n) {
            /* Some unknowns are free; they stay as they are if the equations hold. */
            if (norm <= 1e-9 * fmax(1, before)) return rank < first_rank ? UNDETERMINED : 0;
            if (iteration > 4) return 1;
        } else if ((b->linear && iteration > 0) || change <= SOLVED) {
            return norm <= 1e-6 * fmax(1, before) || change <= SOLVED ? 0 : 1;
        }
    }
    return norm < 1e-8 ? 0 : 1;
}

/* Starts along the first and the second correction of Newton's method from w->first, on both sides, for where the
 * solution that was followed has ended: with positive feedback through a limit, the next one is far away. */
static int newton_from_afar(Work *w, const HybridBlock *b)
{
    double *z = w->h.z, *along = w->along;
    int n = b->n, *rows = w->pivot, *columns = w->pivot + n;
    for (int correction = 0; correction < 2; correction++) {
        double most;
        for (int i = 0; i < n; i++) z[b->slots[i]] = w->first[i] - (correction ? along[i] : 0);
        b->residuals(&w->h, w->r);
        block_jacobian(w, b, w->r, w->lu);
        back_solve(w->lu, n, factorise(w->lu, n, w->scales, rows, columns), rows, columns, w->r, along, w->j);
        most = in_shares(along, w->first, 1e-3, n);
        if (!(most > 0) || !isfinite(most)) return 1;
        for (double share = 1. / 64; share < 2000; share *= 4)
            for (int side = -1; side <= 1; side += 2) {
                for (int i = 0; i < n; i++) z[b->slots[i]] = w->first[i] + side * share / most * along[i];
                if (!newton(w, b, FULL_STEPS)) return 0;
            }
    }
    return 1;
}

/* Whether Newton's method comes back to a solution from beside it, as to a double root. */
static int isolated(Work *w, const HybridBlock *b)
{
    double *z = w->h.z, *solution = w->along;
    int n = b->n, found;
    for (int i = 0; i < n; i++) {
        solution[i] = z[b->slots[i]];
        z[b->slots[i]] += (i % 2 ? 1e-2 : -1e-2) * fmax(1e-3, fabs(solution[i]));
    }
    found = newton(w, b, FULL_STEPS);
    for (int i = 0; i < n; i++) {
        w->next[i] = z[b->slots[i]] - solution[i];
        z[b->slots[i]] = solution[i];
    }
    return found != 1 && in_shares(w->next, solution, 1e-3, n) < 1e-3;
}

/* Where the equations have kinks, as at limits, the residual may have to grow on the way to the solution. */
static int solve_block(Work *w, const HybridBlock *b)
{
    double *z = w->h.z;
    int found = 1;
    for (int i = 0; i < b->n; i++) w->first[i] = z[b->slots[i]];
    for (Damping damping = b->linear ? RESIDUAL : NATURAL; damping <= FULL_STEPS; damping++) {
        for (int i = 0; i < b->n; i++) z[b->slots[i]] = w->first[i];
        found = newton(w, b, damping);
        if (!found) return 0;
    }
    if (b->linear) return found;
    if (found == UNDETERMINED && isolated(w, b)) return 0;
    for (int i = 0; i < b->n; i++) z[b->slots[i]] = w->first[i];
    b->residuals(&w->h, w->r);
    /* A start value of 0 is often none that anybody chose, and nothing can be divided by it, nor by the difference
     * of two that are equal. */
    if (!isfinite(size_of(w->r, b->n)))
        for (int other = 0; other < 2; other++)
            for (double start = 1; start > 1e-4; start /= 1000)
                for (Damping damping = NATURAL; damping <= FULL_STEPS; damping++) {
                    for (int i = 0; i < b->n; i++)
                        z[b->slots[i]] = w->first[i] == 0 ? start * (1 + other * fmod(0.618 * i, 1)) : w->first[i];
                    if (!newton(w, b, damping)) return 0;
                }
    return w->may_jump ? newton_from_afar(w, b) : 1;
}

static int solve_all(Work *w, const HybridBlock *blocks, int n)
{
    for (int i = 0; i < n; i++) {
        if (blocks[i].assign)
            blocks[i].assign(&w->h);
        else if (solve_block(w, &blocks[i]))
            return OUTCOME(BLOCK, i);
    }
    return 0;
}

static int solve(Work *w)
{
    return solve_all(w, hybrid_info.blocks, hybrid_info.n_blocks);
}

/* Derivatives at a time and states; the equations' variables in z follow. */
static int slopes(Work *w, double t, const double *x, double *f)
{
    const HybridInfo *i = &hybrid_info;
    int status;
    w->h.t = t;
    for (int k = 0; k < i->n_states; k++) w->h.z[i->state_slots[k]] = x[k];
    status = solve(w);
    for (int k = 0; k < i->n_states; k++) {
        f[k] = w->h.z[i->slope_slots[k]];
        if (!isfinite(f[k]) && !status) status = OUTCOME(BLOCK, i->n_blocks);
    }
    return status;
}

/* Events */

static int differ(double a, double b)
{
    return !(a == b || (isnan(a) && isnan(b)));
}

/* The first mode whose value has changed; -1 if none. Where events follow each other without end, a relation whose
 * sides are equal but for rounding keeps its truth: so an element of friction stays between sticking and sliding. */
static int changed_mode(Work *w)
{
    const HybridInfo *i = &hybrid_info;
    const double *held = w->h.z + i->mode_slot;
    double *g = w->g + (size_t)MOST_LOOKS * (size_t)i->n_margins;
    int first = -1;
    hybrid_modes(&w->h, w->m);
    if (w->events >= STEADY) hybrid_margins(&w->h, g);
    for (int k = i->n_modes - 1; k >= 0; k--) {
        if (w->events >= STEADY && i->mode_margins[k] >= 0 && fabs(g[i->mode_margins[k]]) <= EQUAL) w->m[k] = held[k];
        if (differ(w->m[k], held[k])) first = k;
    }
    return first;
}

static void take_modes(Work *w)
{
    for (int k = 0; k < hybrid_info.n_modes; k++) w->h.z[hybrid_info.mode_slot + k] = w->m[k];
}

static void conditions(Work *w)
{
    hybrid_conditions(&w->h, w->h.z + hybrid_info.condition_slot, w->c, w->rise);
}

/* Flip one of the changed modes: each in its turn, then the first (which finds the state of diodes whose matrix
 * has positive principal minors; Murty, Linear Complementarity, 1988), then one by chance, at last also one
 * that has not changed: the way from one state of a circuit with positive feedback to the other. */
static void flip_one(Work *w, int round, int *turn, int *mode)
{
    const HybridInfo *i = &hybrid_info;
    double *held = w->h.z + i->mode_slot;
    if (round >= 60 && round < 200) {
        held[*mode] = w->m[*mode];
        return;
    }
    if (round >= 400 && round % 8 == 0) {
        *mode = *turn = round / 8 % i->n_modes;
        if (w->m[*mode] == 0 || w->m[*mode] == 1) held[*mode] = held[*mode] == 0;
        return;
    }
    if (round >= 200) *turn = (int)((*turn * 1103515245u + 12345u + (unsigned)round) % (unsigned)i->n_modes);
    for (int k = 1; k <= i->n_modes; k++) {
        int next = (*turn + k) % i->n_modes;
        if (!differ(w->m[next], held[next])) continue;
        *mode = *turn = next;
        break;
    }
    held[*mode] = w->m[*mode];
}

/* Whether the changed modes are relations whose sides are equal but for rounding: either truth will do. */
static int at_zero(Work *w)
{
    const HybridInfo *i = &hybrid_info;
    hybrid_margins(&w->h, w->g);
    for (int k = 0; k < i->n_modes; k++) {
        int margin = i->mode_margins[k];
        if (differ(w->m[k], w->h.z[i->mode_slot + k]) && (margin < 0 || fabs(w->g[margin]) > EQUAL)) return 0;
    }
    return 1;
}

/* Solve equations, modes and discrete variables together, with `pre` and what has risen held. */
static int round_of_event(Work *w, const HybridBlock *blocks, int n)
{
    const HybridInfo *i = &hybrid_info;
    double *z = w->h.z;
    int mode = -1, turn = -1, status;
    for (int round = 0; round < MOST_FLIPS; round++) {
        int moved = 0;
        if ((status = solve_all(w, blocks, n))) return status;
        if ((mode = changed_mode(w)) >= 0 && !(round >= 60 && w->events < FOLDED && at_zero(w))) {
            /* Modes that flip together may do so for ever: later on one of them at a time. */
            if (round < 20)
                take_modes(w);
            else
                flip_one(w, round, &turn, &mode);
            moved = 1;
        }
        conditions(w);
        for (int k = 0; k < i->n_discretes; k++) w->keep[k] = z[i->discrete_slots[k]];
        hybrid_discretes(&w->h);
        for (int k = 0; k < i->n_discretes; k++) moved |= differ(w->keep[k], z[i->discrete_slots[k]]);
        if (!moved) return 0;
    }
    return mode >= 0 ? OUTCOME(MODES, mode) : OUTCOME(DISCRETES, 0);
}

static void remember(Work *w)
{
    const HybridInfo *i = &hybrid_info;
    for (int k = 0; k < i->n_conditions; k++) w->h.z[i->condition_slot + k] = w->c[k];
    for (int k = 0; k < i->n_pre; k++) w->h.z[i->pre_slots[k]] = w->h.z[i->pre_of[k]];
}

static double next_tick(const Work *w, int k)
{
    return hybrid_info.phases[k] + w->h.z[hybrid_info.clock_slot + k] * hybrid_info.periods[k];
}

static int project(Work *w, double t, double *x);

/* Set states by reinit; those that constraints bind to them follow. */
static int reinitialise(Work *w, int *set)
{
    const HybridInfo *i = &hybrid_info;
    double *z = w->h.z, *x = w->dense[1];
    int status;
    for (int k = 0; k < i->n_states; k++) x[k] = z[i->state_slots[k]];
    *set = hybrid_reinits(&w->h);
    if (!*set || !i->n_constraints) return 0;
    for (int k = 0; k < i->n_states; k++) {
        w->held[k] = differ(x[k], z[i->state_slots[k]]);
        x[k] = z[i->state_slots[k]];
    }
    status = project(w, w->h.t, x);
    memset(w->held, 0, (size_t)i->n_states * sizeof(double));
    for (int k = 0; k < i->n_states; k++) z[i->state_slots[k]] = x[k];
    return status;
}

/* Actions of what rises now wait until the event is over; asserts go before warnings. */
static void act(Work *w)
{
    const HybridInfo *i = &hybrid_info;
    if (!i->n_actions) return;
    hybrid_actions(&w->h, w->keep);
    for (int k = 0; k < i->n_actions; k++)
        if (w->keep[k] != 0 && i->action_rises[k] && (!w->pending || i->action_kinds[k] != ACTION_WARNING))
            w->pending = OUTCOME(ACTION, k);
}

/* The bound that is broken where equations have no solution, else what is known of that. */
static int blamed(Work *w, int status)
{
    const HybridInfo *i = &hybrid_info;
    if (status / 1000000 != BLOCK || !i->n_actions) return status;
    hybrid_actions(&w->h, w->keep);
    for (int k = 0; k < i->n_actions; k++)
        if (w->keep[k] != 0 && i->action_kinds[k] == ACTION_BOUND) return OUTCOME(ACTION, k);
    return status;
}

/* Keep the unknowns of equation blocks, or take them back. */
static void keep_unknowns(Work *w, int back)
{
    double *kept = w->kept, *z = w->h.z;
    w->has_kept = 1;
    for (int b = 0; b < hybrid_info.n_blocks; b++)
        for (int k = 0; !hybrid_info.blocks[b].assign && k < hybrid_info.blocks[b].n; k++, kept++) {
            double *value = &z[hybrid_info.blocks[b].slots[k]];
            *(back ? value : kept) = back ? *kept : *value;
        }
}

/* Repeat an event until nothing changes. */
static int settle(Work *w)
{
    const HybridInfo *i = &hybrid_info;
    double *z = w->h.z;
    for (int k = 0; k < i->n_clocks; k++) {
        double close = 1e-9 * i->periods[k] + 4 * DBL_EPSILON * fabs(w->h.t);
        w->tick[k] = next_tick(w, k) <= w->h.t + close;
        if (w->tick[k]) z[i->clock_slot + k] = floor((w->h.t + close - i->phases[k]) / i->periods[k]) + 1;
    }
    for (int k = 0; k < i->n_pre; k++) z[i->pre_slots[k]] = z[i->pre_of[k]];
    history_pass(&w->h);
    for (int round = 0; round < MOST_ROUNDS; round++) {
        int again = 0, status;
        w->may_jump = 1;
        status = round_of_event(w, i->blocks, i->n_blocks);
        if (status / 1000000 == BLOCK && w->has_kept) {
            /* Where a solution has ended, the last one is a better start than where the search for it went. */
            keep_unknowns(w, 1);
            status = round_of_event(w, i->blocks, i->n_blocks);
        }
        w->may_jump = 0;
        if (status) return blamed(w, status);
        act(w);
        if ((status = reinitialise(w, &again))) return status;
        for (int k = 0; k < i->n_pre_discrete; k++) again |= differ(z[i->pre_slots[k]], z[i->pre_of[k]]);
        remember(w);
        memset(w->tick, 0, (size_t)i->n_clocks * sizeof(double));
        if (!again) return 0;
    }
    return OUTCOME(DISCRETES, 0);
}

static int report(Work *w, int everything)
{
    const HybridInfo *i = &hybrid_info;
    int warning = 0, pending = w->pending;
    if (!i->n_actions) return 0;
    if (pending && (everything || i->action_kinds[pending % 1000000] != ACTION_WARNING)) {
        w->pending = 0;
        return pending;
    }
    conditions(w);
    hybrid_actions(&w->h, w->keep);
    for (int k = 0; k < i->n_actions; k++) {
        if (w->keep[k] == 0 || i->action_rises[k]) continue;
        if (i->action_kinds[k] != ACTION_WARNING) return OUTCOME(ACTION, k);
        if (everything && w->h.z[i->warned_slot + k] == 0) {
            w->h.z[i->warned_slot + k] = 1;
            warning = OUTCOME(ACTION, k);
        }
    }
    return warning;
}

/* Integration */

/* Jacobian of the derivatives by states and time, at t and w->x where they are w->f. Its entries in the order of
 * HybridInfo.rows; dense, [n][n] by rows. `side` 1 or -1: of the differences. */
static int differentiate(Work *w, double t, int side)
{
    const HybridInfo *i = &hybrid_info;
    int n = i->n_states, status;
    double step = side * 1e-7 * fmax(1e-3, fabs(t)), *by = w->b;
    if (!i->factors) memset(w->fx, 0, (size_t)n * (size_t)n * sizeof(double));
    for (int colour = 0; colour < i->n_colours; colour++) {
        memcpy(w->xn, w->x, (size_t)n * sizeof(double));
        for (int k = 0; k < n; k++) {
            if (i->colours[k] != colour) continue;
            w->xn[k] += side * 1e-7 * fmax(fabs(w->x[k]), 1e-3 * i->nominals[k]);
            by[k] = w->xn[k] - w->x[k];
        }
        if ((status = slopes(w, t, w->xn, w->ft))) return status;
        for (int k = 0; k < n; k++) {
            if (i->colours[k] != colour) continue;
            for (int e = i->column_starts[k]; e < i->column_starts[k + 1]; e++) {
                int r = i->rows[e];
                w->fx[i->factors ? e : r * n + k] = (w->ft[r] - w->f[r]) / by[k];
            }
        }
    }
    if ((status = slopes(w, t + step, w->x, w->ft))) return status;
    for (int r = 0; r < n; r++) w->ft[r] = (w->ft[r] - w->f[r]) / step;
    return 0;
}

/* Factors of 1/(h GAMMA) - Jacobian in w->a; 0 if there are none. Sparse ones are found without exchange of
 * rows, since a shorter step makes the diagonal larger. */
static int factorise_step(Work *w, double diagonal)
{
    const HybridInfo *i = &hybrid_info;
    const HybridFactors *s = i->factors;
    int n = i->n_states;
    double *a = w->a, *row = w->spare;
    if (!s) {
        for (int e = 0; e < n * n; e++) a[e] = -w->fx[e];
        for (int k = 0; k < n; k++) a[k * n + k] += diagonal;
        return factorise(a, n, NULL, w->pivot_a, w->pivot_a + n) == n;
    }
    memset(a, 0, (size_t)s->n_entries * sizeof(double));
    for (int k = 0; k < n; k++) a[s->diagonals[k]] = diagonal;
    for (int e = 0; e < i->column_starts[n]; e++) a[s->entries[e]] -= w->fx[e];
    for (int r = 0; r < n; r++) {
        int first = s->starts[r], last = s->starts[r + 1], own = s->diagonals[r];
        double most = 0;
        for (int e = first; e < last; e++) row[s->columns[e]] = a[e];
        for (int e = first; e < own; e++) {
            int c = s->columns[e];
            double v = row[c] /= a[s->diagonals[c]];
            if (v != 0)
                for (int u = s->diagonals[c] + 1; u < s->starts[c + 1]; u++) row[s->columns[u]] -= v * a[u];
        }
        for (int e = first; e < last; e++) {
            a[e] = row[s->columns[e]];
            if (e >= own) most = fmax(most, fabs(a[e]));
        }
        if (!(fabs(a[own]) > 1e-8 * most) || !isfinite(most)) return 0;
    }
    return 1;
}

static void solve_step(Work *w, const double *b, double *x)
{
    const HybridFactors *s = hybrid_info.factors;
    int n = hybrid_info.n_states;
    double *y = w->spare;
    if (!s) {
        back_solve(w->a, n, n, w->pivot_a, w->pivot_a + n, b, x, y);
        return;
    }
    for (int r = 0; r < n; r++) {
        y[r] = b[s->order[r]];
        for (int e = s->starts[r]; e < s->diagonals[r]; e++) y[r] -= w->a[e] * y[s->columns[e]];
    }
    for (int r = n - 1; r >= 0; r--) {
        for (int e = s->diagonals[r] + 1; e < s->starts[r + 1]; e++) y[r] -= w->a[e] * y[s->columns[e]];
        y[r] /= w->a[s->diagonals[r]];
    }
    for (int r = 0; r < n; r++) x[s->order[r]] = y[r];
}

static const double GAMMA = 0.25;
static const double ALPHA[6] = {0, 0.386, 0.21, 0.63, 1, 1};
static const double DELTA[6] = {0.25, -0.1043, 0.1035, -0.03620000000000023, 0, 0};
static const double A[5][5] = {
    {1.544},
    {0.9466785280815826, 0.2557011698983284},
    {3.314825187068521, 2.896124015972201, 0.9986419139977817},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1},
};
static const double C[5][5] = {
    {-5.6688},
    {-2.430093356833875, -0.2063599157091915},
    {-0.1073529058151375, -9.594562251023355, -20.47028614809616},
    {7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160},
    {8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054},
};
static const double D[2][5] = {
    {10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662},
    {-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872},
};

/* Keep the margins of a stage, the `number`-th by its time, after its derivatives. */
static void keep_stage(Work *w, int number)
{
    if (!hybrid_info.n_modes) return;
    hybrid_margins(&w->h, w->along_step + (size_t)number * (size_t)hybrid_info.n_margins);
    if (changed_mode(w) >= 0) w->changes = 1;
}

/* One step of RODAS from t, w->x with w->f, w->fx, w->ft; its end in w->xn, its error in tolerances. */
static int rodas(Work *w, double t, double h, double *error)
{
    const HybridInfo *info = &hybrid_info;
    int n = info->n_states, status;
    static const int order[6] = {0, 2, 1, 3, 4, 4};
    double *slope = w->dense[0];
    w->changes = 0;
    if (!factorise_step(w, 1 / (h * GAMMA))) return OUTCOME(STEP_SIZE, 0);
    for (int s = 0; s < 6; s++) {
        memcpy(w->xn, w->x, (size_t)n * sizeof(double));
        memcpy(slope, w->f, (size_t)n * sizeof(double));
        if (s) {
            for (int o = 0; o < s; o++)
                for (int k = 0; k < n; k++) w->xn[k] += A[s - 1][o] * w->k[o][k];
            if ((status = slopes(w, t + ALPHA[s] * h, w->xn, slope))) return status;
            keep_stage(w, order[s]);
        }
        for (int k = 0; k < n; k++) {
            w->b[k] = slope[k] + h * DELTA[s] * w->ft[k];
            for (int o = 0; o < s; o++) w->b[k] += C[s - 1][o] * w->k[o][k] / h;
        }
        solve_step(w, w->b, w->k[s]);
    }
    *error = 0;
    for (int k = 0; k < n; k++) {
        double scale, one;
        w->xn[k] += w->k[5][k];
        scale = TOLERANCE * (1e-3 * info->nominals[k] + fmax(fabs(w->x[k]), fabs(w->xn[k])));
        one = w->k[5][k] / scale;
        *error += one * one / n;
        w->dense[0][k] = w->dense[1][k] = 0;
        for (int o = 0; o < 5; o++) {
            w->dense[0][k] += D[0][o] * w->k[o][k];
            w->dense[1][k] += D[1][o] * w->k[o][k];
        }
    }
    *error = sqrt(*error);
    return isfinite(*error) ? 0 : OUTCOME(STEP_SIZE, 0);
}

/* Formula of order 5 by Dormand and Prince, J. Comput. Appl. Math. 6 (1980), and its error. */
static const double EXPLICIT_AT[6] = {1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1, 1};
static const double EXPLICIT[6][6] = {
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84},
};
static const double EXPLICIT_ERROR[7] = {
    71.0 / 57600, 0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200, 22.0 / 525, -1.0 / 40,
};

/* As rodas, without Jacobian; the dense output is the cubic through both ends and their slopes. `rate`: the
 * largest eigenvalue times h, as the last two stages show it. */
static int explicit_step(Work *w, double t, double h, double *error, double *rate)
{
    const HybridInfo *info = &hybrid_info;
    int n = info->n_states, status;
    double apart = 0, faster = 0;
    w->changes = 0;
    for (int s = 0; s < 6; s++) {
        memcpy(w->b, w->xn, (size_t)n * sizeof(double)); /* of the stage before */
        for (int k = 0; k < n; k++) {
            double by = EXPLICIT[s][0] * w->f[k];
            for (int o = 1; o <= s; o++) by += EXPLICIT[s][o] * w->k[o - 1][k];
            w->xn[k] = w->x[k] + h * by;
        }
        if ((status = slopes(w, t + EXPLICIT_AT[s] * h, w->xn, w->k[s]))) return status;
        keep_stage(w, s < 5 ? s + 1 : 5);
    }
    *error = 0;
    for (int k = 0; k < n; k++) {
        double scale = FINER * TOLERANCE * (1e-3 * info->nominals[k] + fmax(fabs(w->x[k]), fabs(w->xn[k])));
        double one = EXPLICIT_ERROR[0] * w->f[k], along = w->xn[k] - w->x[k];
        for (int o = 0; o < 6; o++) one += EXPLICIT_ERROR[o + 1] * w->k[o][k];
        one *= h / scale;
        *error += one * one / n;
        w->dense[0][k] = h * w->f[k] - along;
        w->dense[1][k] = 2 * along - h * (w->f[k] + w->k[5][k]);
        apart += (w->xn[k] - w->b[k]) * (w->xn[k] - w->b[k]) / (scale * scale);
        faster += (w->k[5][k] - w->k[4][k]) * (w->k[5][k] - w->k[4][k]) / (scale * scale);
    }
    *error = sqrt(*error);
    *rate = apart > 0 ? h * sqrt(faster / apart) : 0;
    return isfinite(*error) ? 0 : OUTCOME(STEP_SIZE, 0);
}

/* A step by the present kind. */
static int one_step(Work *w, double t, double h, double *error)
{
    double rate;
    return w->stiff ? rodas(w, t, h, error) : explicit_step(w, t, h, error, &rate);
}

/* Count what speaks for the other kind of step. */
static void count_sign(Work *w, int sign)
{
    w->others = sign ? 0 : w->others + 1;
    if (sign) w->signs++;
    if (w->others >= (w->stiff ? 1 : OTHERS)) w->signs = 0;
}

/* The largest sum of a row of the Jacobian: no eigenvalue is larger. */
static double fastest(Work *w)
{
    const HybridInfo *i = &hybrid_info;
    int n = i->n_states;
    double most = 0, *sums = w->spare;
    memset(sums, 0, (size_t)n * sizeof(double));
    for (int k = 0; k < n; k++)
        for (int e = i->column_starts[k]; e < i->column_starts[k + 1]; e++)
            sums[i->rows[e]] += fabs(w->fx[i->factors ? e : i->rows[e] * n + k]);
    for (int r = 0; r < n; r++) most = fmax(most, sums[r]);
    return most;
}

/* Whether a mode has changed at a share of the step, with states by the dense output. */
static int changed_at(Work *w, double t, double h, double share)
{
    int n = hybrid_info.n_states;
    for (int k = 0; k < n; k++)
        w->k[0][k] = (1 - share) * w->x[k] +
                     share * (w->xn[k] + (1 - share) * (w->dense[0][k] + share * w->dense[1][k]));
    /* Where a solution fails, it does for another mode's sake. */
    return slopes(w, t + share * h, w->k[0], w->k[1]) || changed_mode(w) >= 0;
}

/* How a margin bends at the middle one of three looks: the divided difference of second order. */
static double bend(const double *s, const double *g, size_t n)
{
    return ((g[2 * n] - g[n]) / (s[2] - s[1]) - (g[n] - g[0]) / (s[1] - s[0])) / (s[2] - s[0]);
}

/* Whether a margin may cross 0 unseen between looks a and a + 1: whether it bends as much as it is large. */
static int may_hide(const double *margins, const double *shares, int count, int a)
{
    size_t n = (size_t)hybrid_info.n_margins;
    double width = shares[a + 1] - shares[a];
    if (count < 3) return 1;
    for (size_t k = 0; k < n; k++) {
        const double *g = margins + (size_t)a * n + k;
        double most = 0;
        if (a > 0) most = fabs(bend(shares + a - 1, g - n, n));
        if (a + 2 < count) most = fmax(most, fabs(bend(shares + a, g, n)));
        /* Many times what a parabola departs from its chord, for margins that oscillate. */
        if (fmin(fabs(g[0]), fabs(g[n])) < 8 * most * width * width) return 1;
    }
    return 0;
}

/* Look for a changed mode within a step, more closely where margins bend: the bracket of the first found. */
static int look(Work *w, double t, double h, double *low, double *high)
{
    /* Uneven, so that oscillations of no period hide between them. */
    static const double looks[] = {0, 0.09, 0.21, 0.34, 0.47, 0.6, 0.72, 0.87, 1};
    size_t n = (size_t)hybrid_info.n_margins, bytes = n * sizeof(double);
    double shares[MOST_LOOKS + 1];
    int count = 0, event = 0;
    /* Explicit steps are longer. */
    for (int k = 0; k < 9 && !event; k += w->stiff ? 2 : 1) {
        shares[count] = looks[k];
        event = changed_at(w, t, h, looks[k]) && k > 0;
        hybrid_margins(&w->h, w->g + (size_t)count++ * n);
    }
    for (int a = 0; a + 1 < count;) {
        if (count > MOST_LOOKS || shares[a + 1] - shares[a] < 1.0 / 256 ||
            !may_hide(w->g, shares, count, a)) {
            a++;
            continue;
        }
        memmove(w->g + (size_t)(a + 2) * n, w->g + (size_t)(a + 1) * n, (size_t)(count - a - 1) * bytes);
        memmove(shares + a + 2, shares + a + 1, (size_t)(count - a - 1) * sizeof(double));
        shares[a + 1] = shares[a] + 0.46 * (shares[a + 2] - shares[a]);
        count++;
        if (changed_at(w, t, h, shares[a + 1])) {
            event = 1;
            count = a + 2;
        }
        hybrid_margins(&w->h, w->g + (size_t)(a + 1) * n);
    }
    *low = event ? shares[count - 2] : 1;
    *high = shares[count - 1];
    return event;
}

/* Whether the stages of a step show that no margin comes near 0 within it. */
static int quiet(Work *w, double t, double h)
{
    static const double implicit[] = {0, 0.21, 0.386, 0.63, 1}, explicit[] = {0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1};
    int count = w->stiff ? 5 : 6;
    /* Without states there are no stages, and solutions of equation blocks may end between them. */
    if (w->changes || !hybrid_info.n_states || hybrid_info.n_blocks) return 0;
    for (int a = 0; a + 1 < count; a++)
        if (may_hide(w->along_step, w->stiff ? implicit : explicit, count, a)) return 0;
    /* The last stage of an explicit step is its end. */
    return !w->stiff || !(slopes(w, t + h, w->xn, w->k[1]) || changed_mode(w) >= 0);
}

/* As changed_at, by a step of that length. */
static int changed_after(Work *w, double t, double h, double *end)
{
    double error;
    if (h <= 0) return 0;
    if (one_step(w, t, h, &error)) return 1;
    *end = h;
    return slopes(w, t + h, w->xn, w->k[1]) || changed_mode(w) >= 0;
}

/* Length of the part of the step after which a mode has changed; h if none has. */
static double until_event(Work *w, double t, double h, int *event)
{
    double low = 0, high = 1, end = 0;
    /* Then a step by RODAS costs much more than a look at its dense output. */
    int costly = w->stiff && largest() > 16;
    *event = !quiet(w, t, h) && look(w, t, h, &low, &high);
    if (!*event) return h;
    for (int k = 0; k < (costly ? 52 : 12); k++) {
        double middle = 0.5 * (low + high);
        if (changed_at(w, t, h, middle))
            high = middle;
        else
            low = middle;
    }
    if (costly) {
        /* The dense output knows the event as well as the error control knows the states. */
        double more = DBL_EPSILON;
        for (int k = 0; k < 40; k++, more *= 2)
            if (changed_after(w, t, fmin(h, (high + more) * h), &end)) return fmin(h, (high + more) * h);
        changed_after(w, t, h, &end);
        return h;
    }
    low = fmax(0, low - 0.01) * h;
    high = fmin(1, high + 0.01) * h;
    if (!changed_after(w, t, high, &end)) high = h;
    if (changed_after(w, t, low, &end)) low = 0;
    while (high - low > 4 * DBL_EPSILON * fmax(fabs(t), high)) {
        double middle = 0.5 * (low + high);
        if (middle <= low || middle >= high) break;
        if (changed_after(w, t, middle, &end))
            high = middle;
        else
            low = middle;
    }
    changed_after(w, t, high, &end);
    return high;
}

/* Back onto the constraints, by the smallest change of the states. */
static int project(Work *w, double t, double *x)
{
    const HybridInfo *i = &hybrid_info;
    int n = i->n_states, m = i->n_constraints, *rows = w->pivot_a, *columns = w->pivot_a + m;
    double *c = w->k[0], *g = w->fx;
    if (!m) return 0;
    for (int iteration = 0; iteration < 20; iteration++) {
        double most = 0;
        int status = slopes(w, t, x, w->f), rank;
        if (status) return status;
        hybrid_constraints(&w->h, c);
        for (int k = 0; k < n; k++) {
            double kept = x[k], by = 1e-7 * fmax(fabs(kept), 1e-3 * i->nominals[k]);
            x[k] = kept + by;
            by = x[k] - kept;
            status = slopes(w, t, x, w->f);
            hybrid_constraints(&w->h, w->k[1]);
            x[k] = kept;
            if (status) return status;
            for (int r = 0; r < m; r++) g[r * n + k] = w->held[k] != 0 ? 0 : (w->k[1][r] - c[r]) / by;
        }
        for (int r = 0; r < m; r++)
            for (int s = 0; s < m; s++) {
                w->a[r * m + s] = 0;
                for (int k = 0; k < n; k++) w->a[r * m + s] += g[r * n + k] * g[s * n + k];
            }
        rank = factorise(w->a, m, w->scales, rows, columns);
        back_solve(w->a, m, rank, rows, columns, c, w->b, w->spare);
        for (int k = 0; k < n; k++) {
            double by = 0;
            for (int r = 0; r < m; r++) by += g[r * n + k] * w->b[r];
            x[k] -= by;
            by = fabs(by) / (1e-3 * i->nominals[k] + fabs(x[k]));
            if (!isfinite(by)) return OUTCOME(CONSTRAINTS, 0);
            if (by > most) most = by;
        }
        /* At a kink the differences mix two slopes, and the rest shrinks slowly. */
        if (most < 1e-11 || (iteration > 4 && most < 1e-9)) return 0;
    }
    return OUTCOME(CONSTRAINTS, 0);
}

/* The next time that is known to bring an event, before `end`. */
static double next_stop(const Work *w, double t, double end, int *event)
{
    const HybridInfo *i = &hybrid_info;
    double close = 16 * DBL_EPSILON * fabs(end);
    double stop = end;
    *event = 0;
    for (int k = 0; k < i->n_clocks; k++) {
        double at = next_tick(w, k);
        if (at < stop - 1e-9 * i->periods[k] - close) stop = at, *event = 1;
    }
    for (int k = 0; k < i->n_instants; k++)
        if (i->instants[k] > t + close && i->instants[k] < stop - close) stop = i->instants[k], *event = 1;
    return history_stop(&w->h, t, stop, event);
}

/* Keeps what the operands of delays have been from `low` to `high`, shares of the step. */
static int record(Work *w, double t, double h, double low, double high, int depth)
{
    static const double looks[] = {0, 0.25, 0.5, 0.75, 1, 0.1, 0.9};
    int n = hybrid_info.n_states, status, missed = 0;
    double y[5][HISTORY_MOST], more[HISTORY_MOST], lags[HISTORY_MOST];
    for (int s = 0; s < 7 && !missed; s++) {
        double share = low + looks[s] * (high - low);
        for (int k = 0; k < n; k++)
            w->k[0][k] = (1 - share) * w->x[k] +
                         share * (w->xn[k] + (1 - share) * (w->dense[0][k] + share * w->dense[1][k]));
        if ((status = slopes(w, t + share * h, w->k[0], w->k[1]))) return status;
        hybrid_delays(&w->h, s < 5 ? y[s] : more, lags);
        if (s > 4) missed = history_misses(y, more, looks[s]);
    }
    if (missed && depth < 8) {
        double middle = 0.5 * (low + high);
        if ((status = record(w, t, h, low, middle, depth + 1))) return status;
        return record(w, t, h, middle, high, depth + 1);
    }
    return history_add(&w->h, t + low * h, (high - low) * h, y, low == 0) ? 0 : OUTCOME(HISTORY, 0);
}

static int advance(Work *w, double t, double end)
{
    const HybridInfo *i = &hybrid_info;
    double *z = w->h.z, size = z[i->size_slot], last_event = -INFINITY, end_of_solution = -INFINITY;
    double beyond = 0, furthest = 1e-8 * (end - t);
    int n = i->n_states, status, events = 0;
    if ((status = settle(w))) return status;
    /* What delays keep is as exact as the dense output, and that of short implicit steps is the better one. */
    w->stiff = size < 0 || i->n_delays > 0;
    size = fabs(size);
    if (!(size > 0)) size = 1e-3 * (end - t);
    while (t < end) {
        int planned, event = 0, done = 0, tries = 0;
        double stop = next_stop(w, t, end, &planned), h = 0;
        /* What rounding leaves between an event and a known time is no step. */
        if (stop - t <= 8 * DBL_EPSILON * fabs(stop)) t = stop;
        for (int k = 0; k < n; k++) w->x[k] = z[i->state_slots[k]];
        if (stop > t) {
            int refused = 0, ended;
            status = slopes(w, t, w->x, w->ft);
            ended = status / 1000000 == BLOCK; /* the last step came to where the solution ends */
            if (status && !ended) return status;
            if (!ended) memcpy(w->f, w->ft, (size_t)n * sizeof(double));
            if (!ended) keep_stage(w, 0);
            keep_unknowns(w, ended);
            if (!ended && n && w->stiff && (status = differentiate(w, t, 1)) / 1000000 == BLOCK) {
                keep_unknowns(w, 1); /* beyond here the solution may end */
                status = differentiate(w, t, -1);
            }
            ended = status / 1000000 == BLOCK;
            if (status && !ended) return status;
            while (!done) {
                double error = 0, factor, rate = 0;
                int whole;
                h = stop - t;
                whole = !(h > 1.0001 * size);
                if (!whole) h = h < 2 * size ? 0.5 * h : size;
                if (ended || h <= 4 * DBL_EPSILON * fabs(t) || tries++ > 200) {
                    if (status / 1000000 != BLOCK) return status ? status : OUTCOME(STEP_SIZE, 0);
                    /* A solution ends here: an event has to find another. Where it finds the same one, since the
                     * end is known to rounding alone, it tries again later. */
                    beyond = t < end_of_solution + furthest ? 64 * beyond : 16 * DBL_EPSILON * fabs(t);
                    if (beyond > furthest) return status;
                    end_of_solution = t;
                    t = fmin(stop, t + beyond);
                    for (int k = 0; k < n; k++) w->xn[k] = w->x[k] + beyond * w->f[k];
                    size = 1e-3 * (end - t);
                    event = 1;
                    break;
                }
                status = !n        ? slopes(w, t + h, w->x, w->k[1])
                         : w->stiff ? rodas(w, t, h, &error)
                                    : explicit_step(w, t, h, &error, &rate);
                factor = status ? 0.1 : fmin(5, fmax(0.1, 0.9 * pow(fmax(error, 1e-10), w->stiff ? -0.25 : -0.2)));
                if (!n && !status) factor = 5;
                if (n && !w->stiff && !status) count_sign(w, rate > FAST);
                if (status || error > 1) {
                    size = h * factor;
                    refused = 1;
                    keep_unknowns(w, 1);
                    continue;
                }
                /* What is cut to reach a stop says nothing about the size that the error allows. */
                size = whole && factor >= 1 ? fmax(size, h * fmin(factor, refused ? 1 : 5))
                                            : h * fmin(factor, refused ? 1 : 5);
                status = 0;
                if (n && w->stiff && !i->n_delays) count_sign(w, size * fastest(w) < 0.5);
                if (i->n_modes) {
                    h = until_event(w, t, h, &event);
                    whole = whole && !event;
                }
                if (i->n_delays && (status = record(w, t, h, 0, 1, 0))) return status;
                done = 1;
                t = whole ? stop : t + h;
            }
            if (w->signs >= (w->stiff ? CALM : SIGNS)) w->stiff = !w->stiff, w->signs = 0;
            if (n) {
                memcpy(w->x, w->xn, (size_t)n * sizeof(double));
                if ((status = project(w, t, w->x))) return status;
            }
            if ((status = slopes(w, t, w->x, w->f))) {
                /* The solution of before has ended: an event has to find another. */
                if (!event && status / 1000000 != BLOCK) return status;
                event = 1;
            }
        }
        if (event) {
            int mode = changed_mode(w);
            if (t - last_event < 1e-9 * fmax(1e-3, fabs(t)))
                events++;
            else {
                events = 0;
                /* Where events follow each other, a long step may hide some; steps grow again by themselves. */
                size = fmin(size, 4 * (t - last_event));
            }
            if (events > MOST_EVENTS) return OUTCOME(CHATTERING, mode < 0 ? 0 : mode);
            last_event = t;
            if (mode >= 0) take_modes(w);
            w->events = events;
        }
        z[i->end_slot] = t;
        event = event || (planned && t >= stop);
        if (event) {
            w->h.t = t;
            if ((status = settle(w))) return status;
        }
        status = report(w, 0);
        if (status) return status;
        if (z[i->use_slot] == USE_EARLY_RETURN && event && t < end) break;
    }
    z[i->size_slot] = w->stiff ? -size : size;
    w->h.t = z[i->end_slot];
    return report(w, 1);
}

/* Initialisation */

static int initialise(Work *w)
{
    const HybridInfo *i = &hybrid_info;
    double *z = w->h.z;
    int status = 0;
    for (int k = 0; k < i->n_settable; k++)
        if (differ(z[i->settable_slots[k]], z[i->settable_lasts[k]]))
            z[i->settable_starts[k]] = z[i->settable_slots[k]];
    hybrid_dependents(&w->h);
    for (int k = 0; k < i->n_started; k++) z[i->started_slots[k]] = z[i->start_slots[k]];
    for (int k = 0; k < i->n_conditions; k++) z[i->condition_slot + k] = 1;
    for (int k = 0; k < i->n_pre; k++) z[i->pre_slots[k]] = z[i->pre_of[k]];
    for (int k = 0; k < i->n_clocks; k++) {
        double n = ceil((w->h.t - i->phases[k]) / i->periods[k] - 1e-9);
        z[i->clock_slot + k] = n > 0 ? n : 0;
    }
    for (int k = 0; k < i->n_actions; k++) z[i->warned_slot + k] = 0;
    z[i->size_slot] = 0;
    w->h.initial = 1;
    hybrid_modes(&w->h, w->m);
    take_modes(w);
    /* From the simplified equations to the actual ones. */
    for (int k = 0; i->has_homotopy && k < 10; k++) {
        w->h.homotopy = 0.1 * k;
        if (round_of_event(w, i->initial_blocks, i->n_initial_blocks)) break;
    }
    w->h.homotopy = 1;
    status = round_of_event(w, i->initial_blocks, i->n_initial_blocks);
    if (status / 1000000 == BLOCK) {
        int broken = blamed(w, status);
        status = broken == status ? status + 500000 : broken;
    }
    if (!status) {
        act(w);
        remember(w);
        w->h.initial = 0;
        conditions(w);
        for (int k = 0; k < i->n_conditions; k++) z[i->condition_slot + k] = w->c[k];
        z[i->done_slot] = 1;
        history_begin(&w->h);
        if (history_refused(&w->h)) status = OUTCOME(LAG, history_refused(&w->h) - 1);
        if (hybrid_contradiction(&w->h)) status = OUTCOME(START, hybrid_contradiction(&w->h) - 1);
    }
    w->h.initial = 0;
    for (int k = 0; k < i->n_settable; k++) z[i->settable_lasts[k]] = z[i->settable_slots[k]];
    return status;
}

int step_set_up(const StepPoint *at, double *x)
{
    Work *w;
    int status;
    memcpy(x, at->x, (size_t)hybrid_info.n_z * sizeof(double));
    if (!(w = work_for(at, x))) return OUTCOME(MEMORY, 0);
    status = initialise(w);
    free_work(w);
    /* Before the inputs are set a failure may mean nothing: the end of initialisation tries again. */
    return status && at->step_size > 0 ? status : 0;
}

int step_initialise(const StepPoint *at, double *x)
{
    Work *w;
    int status;
    memcpy(x, at->x, (size_t)hybrid_info.n_z * sizeof(double));
    if (!(w = work_for(at, x))) return OUTCOME(MEMORY, 0);
    status = initialise(w);
    if (!status) status = report(w, 1);
    free_work(w);
    return status;
}

int step_advance(const StepPoint *at, double *x)
{
    Work *w;
    int status;
    memcpy(x, at->x, (size_t)hybrid_info.n_z * sizeof(double));
    if (!(w = work_for(at, x))) return OUTCOME(MEMORY, 0);
    status = blamed(w, advance(w, at->time, at->time + at->step_size));
    free_work(w);
    return status;
}

/* Outputs as the event at this time, if there is one, leaves them with the present inputs. */
static void outputs(const ModelPoint *at, const double *z, int events, double *w_out)
{
    StepPoint here = {at->time, 0, at->x, at->u, at->p};
    double *copy = malloc((size_t)hybrid_info.n_z * sizeof(double) + 8);
    Work *w = copy ? work_for(&here, copy) : NULL;
    if (w) {
        memcpy(copy, z, (size_t)hybrid_info.n_z * sizeof(double));
        if (copy[hybrid_info.done_slot] != 0) {
            if (events)
                settle(w);
            else
                solve(w);
        }
        hybrid_outputs(&w->h, w_out);
        free_work(w);
    }
    free(copy);
}

void model_algebraics(const ModelPoint *at, double *w)
{
    /* Of an importer that integrates, events wait for its event mode. */
    outputs(at, at->x, at->x[hybrid_info.use_slot] != USE_CONTINUOUS_TIME, w);
}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand)
{
    size_t n_z = (size_t)model_info.n_x, n_u = (size_t)model_info.n_u, n_w = (size_t)model_info.n_w;
    double *z = malloc((n_z + n_u + n_w + 1) * sizeof(double)), *u = z + n_z, *other = u + n_u;
    ModelPoint moved = {at->time, z, u, at->p, at->d, at->m};
    double step = INFINITY;
    (void)xdot, (void)operand;
    if (!z) return;
    for (size_t k = 0; k < n_z; k++)
        if (seed->x[k] != 0) step = fmin(step, (fabs(at->x[k]) + 1) / fabs(seed->x[k]));
    for (size_t k = 0; k < n_u; k++)
        if (seed->u[k] != 0) step = fmin(step, (fabs(at->u[k]) + 1) / fabs(seed->u[k]));
    /* The cube root of the machine precision balances truncation and rounding. */
    step = isfinite(step) ? 6e-6 * step : 0;
    for (int side = -1; side <= 1; side += 2) {
        for (size_t k = 0; k < n_z; k++) z[k] = at->x[k] + side * step * seed->x[k];
        for (size_t k = 0; k < n_u; k++) u[k] = at->u[k] + side * step * seed->u[k];
        outputs(&moved, z, 0, side < 0 ? other : w);
    }
    for (size_t k = 0; k < n_w; k++) w[k] = step > 0 ? (w[k] - other[k]) / (2 * step) : 0;
    free(z);
}

/* Model exchange: the importer integrates. In all of it `z` is read and written. */

static int with_work(const StepPoint *at, double *z, int (*task)(Work *, void *), void *argument)
{
    Work *w = work_for(at, z);
    int status;
    if (!w) return OUTCOME(MEMORY, 0);
    status = task(w, argument);
    free_work(w);
    return status;
}

static int evaluate_here(Work *w)
{
    for (int k = 0; k < hybrid_info.n_states; k++) w->x[k] = w->h.z[hybrid_info.state_slots[k]];
    return slopes(w, w->h.t, w->x, w->f);
}

static int evaluate(Work *w, void *g)
{
    int status = evaluate_here(w);
    if (g && !status) hybrid_margins(&w->h, g);
    return status;
}

int exchange_evaluate(const StepPoint *at, double *z, double *g)
{
    return with_work(at, z, evaluate, g);
}

static double next_event(const Work *w)
{
    const HybridInfo *i = &hybrid_info;
    double after = w->h.t + 16 * DBL_EPSILON * fabs(w->h.t), next = INFINITY;
    for (int k = 0; k < i->n_clocks; k++) next = fmin(next, fmax(next_tick(w, k), after));
    for (int k = 0; k < i->n_instants; k++)
        if (i->instants[k] > after) next = fmin(next, i->instants[k]);
    return next;
}

/* An importer locates a state event as well as it can, perhaps just before a mode changes: then go on by
 * less than any importer's tolerance, so that the event is seen. */
static int look_ahead(Work *w)
{
    double by = 1e-12 * (1 + fabs(w->h.t)), t = w->h.t;
    int status = evaluate_here(w);
    if (status || !hybrid_info.n_modes || changed_mode(w) >= 0) return status;
    for (int k = 0; k < hybrid_info.n_states; k++) w->xn[k] = w->x[k] + by * w->f[k];
    if (!slopes(w, t + by, w->xn, w->k[0]) && changed_mode(w) >= 0) return 0;
    return slopes(w, t, w->x, w->f);
}

static int handle_event(Work *w, void *argument)
{
    const HybridInfo *i = &hybrid_info;
    ExchangeEvent *event = argument;
    double *z = w->h.z;
    int status;
    event->states_changed = event->terminate = 0;
    for (int k = 0; k < i->n_states; k++) w->dense[0][k] = z[i->state_slots[k]];
    /* In the modes of before there may be no solution any more: the event finds others. */
    look_ahead(w);
    if ((status = settle(w))) return status;
    if (i->n_constraints) {
        for (int k = 0; k < i->n_states; k++) w->x[k] = z[i->state_slots[k]];
        if ((status = project(w, w->h.t, w->x))) return status;
        if ((status = slopes(w, w->h.t, w->x, w->f))) return status;
    }
    for (int k = 0; k < i->n_states; k++)
        event->states_changed |= differ(w->dense[0][k], z[i->state_slots[k]]);
    event->next = next_event(w);
    status = report(w, 1);
    if (status && step_status(status) == RT_DISCARD) event->terminate = 1;
    return status;
}

int exchange_event(const StepPoint *at, double *z, ExchangeEvent *event)
{
    return with_work(at, z, handle_event, event);
}

/* Whether the states are further from their constraints than an importer's tolerances explain. */
static int drifted(Work *w)
{
    const HybridInfo *i = &hybrid_info;
    int n = i->n_states;
    if (!i->n_constraints) return 0;
    memcpy(w->dense[1], w->x, (size_t)n * sizeof(double));
    if (project(w, w->h.t, w->dense[1])) return 1;
    for (int k = 0; k < n; k++)
        if (fabs(w->dense[1][k] - w->x[k]) > 1e-7 * (i->nominals[k] + fabs(w->x[k]))) return 1;
    return 0;
}

/* Whether a discrete variable is another one now though no mode has changed, as by a function of time. */
static int stepped(Work *w)
{
    const HybridInfo *i = &hybrid_info;
    int moved = 0;
    conditions(w);
    for (int k = 0; k < i->n_discretes; k++) w->keep[k] = w->h.z[i->discrete_slots[k]];
    hybrid_discretes(&w->h);
    for (int k = 0; k < i->n_discretes; k++) {
        moved |= differ(w->keep[k], w->h.z[i->discrete_slots[k]]);
        w->h.z[i->discrete_slots[k]] = w->keep[k];
    }
    return moved;
}

static int complete_step(Work *w, void *argument)
{
    ExchangeEvent *event = argument;
    int status = evaluate_here(w);
    if (status) return status;
    event->wanted = changed_mode(w) >= 0 || stepped(w) || drifted(w);
    if ((status = evaluate_here(w))) return status;
    status = report(w, 1);
    event->terminate = status && step_status(status) == RT_DISCARD;
    return status;
}

int exchange_step_completed(const StepPoint *at, double *z, ExchangeEvent *event)
{
    return with_work(at, z, complete_step, event);
}

/* Messages */

int step_status(int outcome)
{
    int code = outcome / 1000000, index = outcome % 1000000;
    if (!outcome) return RT_OK;
    if (code == ACTION && hybrid_info.action_kinds[index] == ACTION_WARNING) return RT_WARNING;
    if (code == ACTION && hybrid_info.action_kinds[index] == ACTION_TERMINATE) return RT_DISCARD;
    return RT_ERROR;
}

void step_message(int outcome, const StepPoint *at, const char *name, Text *text)
{
    int code = outcome / 1000000, index = outcome % 1000000;
    const HybridInfo *i = &hybrid_info;
    (void)name;
    text_add(text, "from t = ");
    text_format(text, "%.9g", at->time);
    text_add(text, " s: ");
    switch (code) {
    case BLOCK:
        if (index >= 500000) {
            text_add(text, "initialisation: the equations cannot be solved for ");
            text_add(text, i->initial_blocks[index - 500000].names);
        } else if (index >= i->n_blocks) {
            text_add(text, "a derivative is not finite");
        } else {
            text_add(text, "the equations cannot be solved for ");
            text_add(text, i->blocks[index].names);
        }
        break;
    case STEP_SIZE: text_add(text, "the integration needs steps that are too small"); break;
    case MODES:
        text_add(text, "no consistent truth is found for the relation ");
        text_add(text, i->mode_names[index]);
        break;
    case CHATTERING:
        text_add(text, "chattering: events follow each other without end at the relation ");
        text_add(text, i->mode_names[index]);
        break;
    case DISCRETES: text_add(text, "the discrete variables do not settle at an event"); break;
    case ACTION:
        if (i->action_kinds[index] == ACTION_TERMINATE) text_add(text, "the model terminates: ");
        text_add(text, i->messages[index]);
        break;
    case CONSTRAINTS: text_add(text, "the states cannot be brought back onto their constraints"); break;
    case HISTORY:
        text_add(text, "a delay() needs too many steps within its delay time; delay a smoother signal");
        break;
    case LAG:
        text_add(text, "the delay time has to be above 0 s: ");
        text_add(text, i->delayed_names[index]);
        break;
    case START:
        text_add(text, "initialisation: the other equations contradict ");
        text_add(text, i->checked[index]);
        break;
    default: text_add(text, "no memory");
    }
}
