/* One internal step: an explicit Runge-Kutta pair of order 5(4) with dense output.
 *
 * Coefficients: J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comp. Appl.
 * Math. 6 (1980), RK5(4)7M; dense output of order 4: E. Hairer, S. P. Norsett, G. Wanner, Solving
 * Ordinary Differential Equations I, 2nd ed. 1993, section II.6.
 *
 * Internal steps end at the communication point, at events and at propagated jumps. An event inside a
 * step is located on the dense output; then the step is repeated so that it ends there, until the event
 * lies at its end: what is kept is always a full Runge-Kutta step with the modes it began with.
 */
#include <float.h>
#include <math.h>
#include <string.h>

#include "integrate.h"

static const double C[7] = {0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1, 1};
static const double A[7][6] = {{0},
                               {1.0 / 5},
                               {3.0 / 40, 9.0 / 40},
                               {44.0 / 45, -56.0 / 15, 32.0 / 9},
                               {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
                               {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
                               {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}};
static const double E[7] = {71.0 / 57600,      0,          -71.0 / 16695, 71.0 / 1920,
                            -17253.0 / 339200, 22.0 / 525, -1.0 / 40};
static const double D[7] = {-12715105075.0 / 11282082432.0,  0,
                            87487479700.0 / 32700410799.0,   -10690763975.0 / 1880347072.0,
                            701980252875.0 / 199316789632.0, -1453857185.0 / 822651844.0,
                            69997945.0 / 29380423.0};

/* The fraction of the relative tolerance that a state's nominal value adds to its own size. */
static const double NOMINAL_SHARE = 1e-3;
/* Fourth difference allowed in an operand's five samples, in relative tolerances: the polynomial through
 * them is then good to about 10 tolerances. */
static const double HISTORY_SHARE = 1e4;
/* An operand may be as rough as it likes: it shortens steps down to this share of the communication step. */
static const double ROUGH_SHARE = 1.0 / 4096;
enum { MAX_OVERLAP_ITERATIONS = 12 };

/* Resolution of event times [s]. */
double rt_event_tolerance(const Runtime *rt)
{
    double size = fabs(rt->t0) + rt->step_size;
    for (int j = 0; j < model_info.n_d; j++) size += rt->lag[j];
    return 1e-13 * rt->step_size + 64 * DBL_EPSILON * size;
}

static void dense_state(const Runtime *rt, double theta, double *x)
{
    double rest = 1 - theta;
    for (int i = 0; i < model_info.n_x; i++)
        x[i] = rt->dense[0][i] +
               theta * (rt->dense[1][i] +
                        rest * (rt->dense[2][i] + theta * (rt->dense[3][i] + rest * rt->dense[4][i])));
}

static void make_dense(Runtime *rt)
{
    for (int i = 0; i < model_info.n_x; i++) {
        double step = rt->x_new[i] - rt->x[i], slope = rt->h * rt->k[0][i] - step, bend = 0;
        for (int s = 0; s < 7; s++) bend += D[s] * rt->k[s][i];
        rt->dense[0][i] = rt->x[i];
        rt->dense[1][i] = step;
        rt->dense[2][i] = slope;
        rt->dense[3][i] = step - rt->h * rt->k[6][i] - slope;
        rt->dense[4][i] = rt->h * bend;
    }
}

/* All stages from x at t0 to x_new at `end`; k[0] is there. Operand and delay time of the end stay in
 * operand_stage and lag_stage. */
static int stages(Runtime *rt, double end)
{
    int n = model_info.n_x;
    for (int s = n ? 1 : 6; s < 7; s++) {
        double *x = s == 6 ? rt->x_new : rt->x_stage;
        for (int i = 0; i < n; i++) {
            double sum = 0;
            for (int r = 0; r < s; r++) sum += A[s][r] * rt->k[r][i];
            x[i] = rt->x[i] + rt->h * sum;
        }
        if (rt_field(rt, s >= 5 ? end : rt->t0 + C[s] * rt->h, x, rt->k[s], rt->operand_stage, rt->lag_stage))
            return 1;
    }
    return 0;
}

/* Largest scaled error, and the state it is in. */
static double error_norm(const Runtime *rt, int *worst)
{
    double norm = 0;
    *worst = 0;
    for (int i = 0; i < model_info.n_x; i++) {
        double error = 0, size = fmax(fabs(rt->x[i]), fabs(rt->x_new[i]));
        for (int s = 0; s < 7; s++) error += E[s] * rt->k[s][i];
        error = fabs(rt->h * error) / (rt->s.tolerance * (size + NOMINAL_SHARE * rt->nominal[i]));
        if (!(error <= norm)) {
            norm = error;
            *worst = i;
        }
        if (!isfinite(error)) return INFINITY;
    }
    return norm;
}

/* Whether modes and pieces still agree at a fraction of the step; x at that place is in `x`. */
static int disagrees(Runtime *rt, double time, const double *x, const double *lag)
{
    ModelPoint at = {time, x, rt_inputs(rt, time), rt->p, rt->d_stage, rt->m};
    if (model_info.n_d && delay_crossed(rt, time, lag)) return 1;
    if (!model_info.n_m) return 0;
    model_relations(&at, rt->relations);
    for (int i = 0; i < model_info.n_m; i++) {
        double r = rt->relations[i];
        double now = model_relation_strict[i] ? r > 0 : r >= 0;
        if (now != rt->m[i]) return 1;
    }
    return 0;
}

/* The same at any fraction, with the operands as a by-product; -1 if the delays cannot be evaluated. */
static int look(Runtime *rt, double theta, double end)
{
    double time = theta == 1 ? end : rt->t0 + theta * rt->h;
    double *x = theta == 1 ? rt->x_new : rt->x_stage;
    ModelPoint at = {time, x, rt_inputs(rt, time), rt->p, rt->d_stage, rt->m};
    if (theta < 1) dense_state(rt, theta, x);
    if (model_info.n_d && delay_values(rt, &at, rt->d_stage, rt->operand_stage, rt->lag_stage, READ_FROZEN))
        return -1;
    return disagrees(rt, time, x, rt->lag_stage);
}

/* Sample the operands and look for the first quarter that ends in disagreement: 1 to 4, or 0; `*at_end`
 * tells whether the fourth does. */
static int sample(Runtime *rt, double end, int *quarter, int *at_end)
{
    *quarter = *at_end = 0;
    for (int q = 1; q <= 4; q++) {
        int found = look(rt, q / 4.0, end);
        if (found < 0) return 1;
        for (int j = 0; j < model_info.n_d; j++) {
            if (!isfinite(rt->operand_stage[j]))
                return rt_fail(rt, RT_ERROR, "delay operator %d at t = %.9g s: operand is %g", j + 1,
                               rt->t0 + q / 4.0 * rt->h, rt->operand_stage[j]);
            rt->samples[5 * j + q] = rt->operand_stage[j];
        }
        if (found && !*quarter) *quarter = q;
        if (q == 4) *at_end = found;
    }
    for (int j = 0; j < model_info.n_d; j++) rt->samples[5 * j] = rt->operand[j];
    return 0;
}

/* New polynomials of the operands; returns how far they moved, in tolerances. */
static double update_guess(Runtime *rt)
{
    double moved = 0;
    for (int j = 0; j < model_info.n_d; j++) {
        const double *y = rt->samples + 5 * j;
        double *c = rt->guess + 5 * j, size = 0;
        for (int i = 0; i < 5; i++) size = fmax(size, fabs(y[i]));
        for (int i = 1; i < 5; i++) {
            double theta = i / 4.0,
                   old = c[0] + theta * (c[1] + theta * (c[2] + theta * (c[3] + theta * c[4])));
            double change = fabs(y[i] - old);
            if (change > 0) moved = fmax(moved, change / (1e-3 * rt->s.tolerance * size));
        }
        delay_polynomial(y, c);
    }
    return moved;
}

/* Factor on the step size that the roughest operand asks for. */
static double history_factor(const Runtime *rt)
{
    double factor = 10;
    for (int j = 0; j < model_info.n_d; j++) {
        const double *y = rt->samples + 5 * j;
        double fourth = fabs((y[4] + y[0]) - 4 * (y[3] + y[1]) + 6 * y[2]);
        double scale = rt->delays[j].scale;
        for (int i = 0; i < 5; i++) scale = fmax(scale, fabs(y[i]));
        /* 16 roundings of the operand are no curvature. */
        if (fourth <= 16 * DBL_EPSILON * scale) continue;
        factor = fmin(factor, 0.9 * sqrt(sqrt(HISTORY_SHARE * rt->s.tolerance * scale / fourth)));
    }
    return factor;
}

/* Bisect for the place where agreement ends, between the start and the end of a quarter. */
static double locate(Runtime *rt, int quarter, double end)
{
    double low = (quarter - 1) / 4.0, high = quarter / 4.0, width = rt_event_tolerance(rt) / rt->h / 2;
    if (quarter == 4 && 1 - width > low) {
        /* Mostly the step has been cut to end here. */
        if (!look(rt, 1 - width, end)) return 1;
        high = 1 - width;
    }
    while (high - low > width) {
        double middle = low + (high - low) / 2;
        if (look(rt, middle, end)) high = middle;
        else low = middle;
    }
    return high;
}

/* Set out from t0 to `end`, with the operands as they are at t0 as the first guess. */
static void set_out(Runtime *rt, double end)
{
    rt->h = end - rt->t0;
    rt->stepping = 1;
    for (int j = 0; j < model_info.n_d; j++) {
        memset(rt->guess + 5 * j, 0, 5 * sizeof(double));
        rt->guess[5 * j] = rt->operand[j];
    }
}

double rt_step_error(Runtime *rt, double end)
{
    int worst;
    set_out(rt, end);
    return stages(rt, end) ? INFINITY : error_norm(rt, &worst);
}

Verdict rt_attempt(Runtime *rt, double end, double *factor, int *event)
{
    return rt_attempt_within(rt, end, 1, factor, event);
}

/* Try the internal step from t0 to `end`. `*factor`: what to multiply the step size with, then or next
 * time. Accepted: x_new and k[6] hold the end, the discrete state disagrees there if `*event` is 1.
 * Without an event operand_stage and lag_stage belong to the end, too. */
Verdict rt_attempt_within(Runtime *rt, double end, double allowed, double *factor, int *event)
{
    int worst, quarter = 0, at_end = 0, sampled = model_info.n_d || model_info.n_m;
    double error;
    *event = 0;
    set_out(rt, end);
    for (int iteration = 0;; iteration++) {
        double moved;
        rt->overlapped = 0;
        *factor = 0.2;
        if (stages(rt, end)) return STEP_REJECTED;
        error = error_norm(rt, &worst);
        if (!(error <= allowed) || isinf(error)) {
            if (isinf(error))
                rt_fail(rt, RT_DISCARD, "state %s or its derivative is not finite", rt_state_name(worst));
            else
                rt_fail(rt, RT_DISCARD, "the error of state %s exceeds the relative tolerance %.3g",
                        rt_state_name(worst), rt->s.tolerance);
            /* 0.9: safety; 5: order of the error estimate */
            *factor = isinf(error) ? 0.1 : fmax(0.2, 0.9 * pow(error, -0.2));
            return STEP_REJECTED;
        }
        if (!sampled) break;
        make_dense(rt);
        if (sample(rt, end, &quarter, &at_end)) return STEP_REJECTED;
        moved = model_info.n_d ? update_guess(rt) : 0;
        if (!rt->overlapped || moved <= 1) break;
        if (iteration == MAX_OVERLAP_ITERATIONS || !isfinite(moved)) {
            rt_fail(rt, RT_DISCARD, "a delay shorter than the internal step does not converge");
            *factor = 0.5;
            return STEP_REJECTED;
        }
    }
    *factor = error < 5.9e-6 ? 10 : 0.9 * pow(error, -0.2); /* 10: most a step may grow at once */
    if (error > 1) *factor = 1;                             /* allowed: no measure of the next one */
    if (model_info.n_d) {
        double rough = history_factor(rt);
        if (rough < 0.9 && rt->h > ROUGH_SHARE * rt->step_size) {
            *factor = fmax(0.2, rough);
            return STEP_SHORTEN;
        }
        *factor = fmin(*factor, rough);
    }
    if (quarter) {
        double place = locate(rt, quarter, end);
        if ((1 - place) * rt->h > rt_event_tolerance(rt)) {
            *factor = place;
            return STEP_EVENT;
        }
        /* Disagreement that comes and goes within the resolution of time is none. */
        *event = at_end;
        if (!at_end && look(rt, 1, end) < 0) return STEP_REJECTED;
    }
    return STEP_ACCEPTED;
}
