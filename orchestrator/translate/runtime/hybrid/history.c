/* Delay operators: what each operand has been, as polynomials of degree 4 in a ring within z.
 *
 * Where an operand jumps, a border stands between two of its segments. An operator reads to the left of a border
 * until an event passes it, so that no step of the integration goes over a delayed jump.
 */
#include <float.h>
#include <math.h>

#include "hybrid.h"

enum { FIRST, NEXT, BORDER, BEFORE, START, LAG, HEAD };
enum { BEGIN, LENGTH, COEFFICIENTS, JUMPS = 7, SEGMENT };

static double *ring(const Hybrid *h, int k)
{
    return h->z + hybrid_info.history_slot + k * (HEAD + SEGMENT * HISTORY_SEGMENTS);
}

static double *segment(double *r, double number)
{
    return r + HEAD + SEGMENT * (int)fmod(number, HISTORY_SEGMENTS);
}

static double slack(double t)
{
    return 8 * DBL_EPSILON * (fabs(t) + 1e-3);
}

static double value_at(const double *s, double t)
{
    double x = (t - s[BEGIN]) / s[LENGTH];
    const double *c = s + COEFFICIENTS;
    x = x < 0 ? 0 : x > 1.5 ? 1.5 : x;
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])));
}

void history_begin(const Hybrid *h)
{
    double values[HISTORY_MOST], lags[HISTORY_MOST];
    if (!hybrid_info.n_delays) return;
    hybrid_delays(h, values, lags);
    for (int k = 0; k < hybrid_info.n_delays; k++) {
        double *r = ring(h, k);
        r[FIRST] = r[NEXT] = 0;
        r[BORDER] = -1;
        r[BEFORE] = values[k];
        r[START] = h->t;
        r[LAG] = lags[k];
    }
}

int history_refused(const Hybrid *h)
{
    for (int k = 0; k < hybrid_info.n_delays; k++)
        if (!(ring(h, k)[LAG] > 0)) return k + 1;
    return 0;
}

double hybrid_delayed(const Hybrid *h, int k)
{
    double *r = ring(h, k), t = h->t - r[LAG], low = r[FIRST], high = r[NEXT];
    if (h->initial) {
        double values[HISTORY_MOST], lags[HISTORY_MOST];
        hybrid_delays(h, values, lags);
        return values[k];
    }
    if (t <= r[START] || high <= low) return r[BEFORE];
    if (r[BORDER] >= 0) high = r[BORDER];
    if (high <= low) return r[BEFORE]; /* a jump right at the start */
    while (high - low > 1) {
        double middle = floor(0.5 * (low + high));
        if (segment(r, middle)[BEGIN] <= t + slack(t))
            low = middle;
        else
            high = middle;
    }
    return value_at(segment(r, low), t);
}

/* Passes the borders that are reached now. */
void history_pass(const Hybrid *h)
{
    for (int k = 0; k < hybrid_info.n_delays; k++) {
        double *r = ring(h, k);
        while (r[BORDER] >= 0 && segment(r, r[BORDER])[BEGIN] + r[LAG] <= h->t + 2 * slack(h->t)) {
            double n = r[BORDER] + 1;
            while (n < r[NEXT] && segment(r, n)[JUMPS] == 0) n++;
            r[BORDER] = n < r[NEXT] ? n : -1;
        }
    }
}

/* The next border after t, before `stop`; and no step is longer than a delay. */
double history_stop(const Hybrid *h, double t, double stop, int *event)
{
    for (int k = 0; k < hybrid_info.n_delays; k++) {
        double *r = ring(h, k), close = 2 * slack(t);
        if (t + r[LAG] < stop) stop = t + r[LAG], *event = 0;
        if (r[BORDER] < 0) continue;
        double at = segment(r, r[BORDER])[BEGIN] + r[LAG];
        /* A border that the last step brought with it may be due at once. */
        if (at < stop + close) stop = fmax(at, t), *event = 1;
        if (at <= t + close) stop = t;
    }
    return stop;
}

/* Adds values of the operands at 0, 1/4, 1/2, 3/4, 1 of a part of a step; 0 if there is no room. */
int history_add(const Hybrid *h, double begin, double length, const double y[5][HISTORY_MOST], int first)
{
    for (int k = 0; k < hybrid_info.n_delays; k++) {
        double *r = ring(h, k), *s, *c, end = r[NEXT] > r[FIRST] ? NAN : r[BEFORE];
        double d1 = y[1][k] - y[0][k], d2 = y[2][k] - 2 * y[1][k] + y[0][k];
        double d3 = (y[3][k] - y[0][k]) - 3 * (y[2][k] - y[1][k]);
        double d4 = (y[4][k] + y[0][k]) - 4 * (y[3][k] + y[1][k]) + 6 * y[2][k];
        while (r[NEXT] - r[FIRST] > 1 && segment(r, r[FIRST] + 1)[BEGIN] < begin - r[LAG] && r[BORDER] != r[FIRST] + 1)
            r[FIRST]++;
        if (r[NEXT] - r[FIRST] >= HISTORY_SEGMENTS) return 0;
        if (r[NEXT] > r[FIRST]) {
            double *last = segment(r, r[NEXT] - 1);
            end = value_at(last, last[BEGIN] + last[LENGTH]);
        }
        s = segment(r, r[NEXT]);
        c = s + COEFFICIENTS;
        s[BEGIN] = begin;
        s[LENGTH] = length;
        s[JUMPS] = first && fabs(y[0][k] - end) > 1e-9 * (fabs(end) + fabs(y[0][k]) + 1e-9);
        c[0] = y[0][k];
        c[1] = 4 * (d1 - d2 / 2 + d3 / 3 - d4 / 4);
        c[2] = 16 * (d2 / 2 - d3 / 2 + 11 * d4 / 24);
        c[3] = 64 * (d3 / 6 - d4 / 4);
        c[4] = 256 * (d4 / 24);
        if (s[JUMPS] != 0 && r[BORDER] < 0) r[BORDER] = r[NEXT];
        r[NEXT]++;
    }
    return 1;
}

/* Whether the last segments miss values at a share of their length. */
int history_misses(const double y[5][HISTORY_MOST], const double *value, double x)
{
    for (int k = 0; k < hybrid_info.n_delays; k++) {
        /* Lagrange's polynomial through the five values. */
        double sum = 0, most = 0;
        for (int a = 0; a < 5; a++) {
            double product = y[a][k];
            for (int b = 0; b < 5; b++)
                if (b != a) product *= (4 * x - b) / (a - b);
            sum += product;
            most = fmax(most, fabs(y[a][k]));
        }
        if (fabs(sum - value[k]) > 1e-9 * (most + 1e-3)) return 1;
    }
    return 0;
}
