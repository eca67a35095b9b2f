/* The effects of orchestrator/effects, the same operations in the same order, so that both give the same
 * bits. Their numbers are places in EFFECTS of orchestrator/exchange/system_contents.py; the Python classes tell what
 * options and memories hold. */
#include <math.h>
#include <stdint.h>

#include "system.h"

enum {
    GAIN, OFFSET, DELAY, LOW_PASS, SAMPLE_AND_HOLD, SATURATE, QUANTISE, RATE_LIMIT, DEAD_BAND, BACKLASH, NOISE,
    DRIFT, DROPOUT, JITTER, MAP, RELAY
};

static const double PI = 3.141592653589793;

/* The signal as it was `back` earlier, at most `longest`; see orchestrator/effects/delay.py. */
static double earlier(double time, double x, double back, double longest, int told, double before,
                      double *memory, int n_memory, int commit)
{
    int size = (n_memory - 3) / 2, count = (int)memory[0], oldest = (int)memory[1], older = count;
    double wanted = time - back, right_time = time, right = x, left_time = time, left = x, y;
    while (older > 0 && left_time > wanted) {
        int place = 3 + (oldest + --older) % size;
        right_time = left_time;
        right = left;
        left_time = memory[place];
        left = memory[place + size];
    }
    y = left;
    if (left_time <= wanted) {
        if (right_time > left_time) {
            double share = (wanted - left_time) / (right_time - left_time);
            /* Times are rounded: a delay of whole steps is to meet the points. */
            if (share > 1.0 - 1e-9) y = right;
            else if (share > 1e-9) y = left + share * (right - left);
        }
    } else if (told && (count == 0 || memory[2] != 0.0)) {
        y = before;
        if (count > 0 && left_time - wanted <= 1e-9 * (right_time - left_time)) y = left;
    }
    if (commit) {
        int place;
        if (count == 0) memory[2] = 1.0;
        while (count > 1 && memory[3 + (oldest + 1) % size] <= time - longest) {
            oldest = (oldest + 1) % size;
            count--;
            memory[2] = 0.0;
        }
        if (count == size) return NAN;
        place = 3 + (oldest + count) % size;
        memory[place] = time;
        memory[place + size] = x;
        memory[0] = count + 1;
        memory[1] = oldest;
    }
    return y;
}

static double low_pass(double time, double x, const double *options, double *memory, int commit)
{
    double y = x;
    if (options[0] == 0.0) return x;
    if (memory[0] != 0.0) {
        y = memory[3];
        if (time > memory[1]) {
            double ratio = (time - memory[1]) / options[0], gone = -expm1(-ratio);
            y += gone * (memory[2] - y) + (1.0 - gone / ratio) * (x - memory[2]);
        }
    }
    if (commit) {
        memory[0] = 1.0;
        memory[1] = time;
        memory[2] = x;
        memory[3] = y;
    }
    return y;
}

static double sample_and_hold(double time, double x, const double *options, double *memory, int commit)
{
    double start = memory[0] != 0.0 ? memory[1] : time, number, y = x;
    if (options[0] == 0.0) return x;
    /* Grids meet sampling instants up to rounding: a millionth of a period early counts. */
    number = floor((time - start - options[1]) / options[0] + 1e-6);
    if (memory[0] != 0.0) {
        y = memory[3];
        if (number > memory[2]) {
            double behind = time - (start + options[1] + number * options[0]), step = time - memory[4];
            y = x;
            if (behind > 1e-6 * step && step > 0.0) {
                double share = behind / step < 1.0 ? behind / step : 1.0;
                y = x + share * (memory[5] - x);
            }
        }
    }
    if (commit) {
        memory[0] = 1.0;
        memory[1] = start;
        memory[2] = number;
        memory[3] = y;
        memory[4] = time;
        memory[5] = x;
    }
    return y;
}

static double rate_limit(double time, double x, const double *options, double *memory, int commit)
{
    double y = x;
    if (memory[0] != 0.0 && time > memory[1]) {
        double most = options[0] * (time - memory[1]);
        if (y > memory[2] + most) y = memory[2] + most;
        else if (y < memory[2] - most) y = memory[2] - most;
    }
    if (commit) {
        memory[0] = 1.0;
        memory[1] = time;
        memory[2] = y;
    }
    return y;
}

static double backlash(double x, const double *options, double *memory, int commit)
{
    double y = x, half = 0.5 * options[0];
    if (options[0] == 0.0) return x;
    if (memory[0] != 0.0) {
        y = memory[1];
        if (x - half > y) y = x - half;
        else if (x + half < y) y = x + half;
    }
    if (commit) {
        memory[0] = 1.0;
        memory[1] = y;
    }
    return y;
}

static double relay(double x, const double *options, double *memory, int commit)
{
    double sign = memory[0];
    if (options[0] == 0.0) return x;
    if (sign == 0.0) sign = x >= 0.0 ? 1.0 : -1.0;
    if (x > 0.5 * options[1]) sign = 1.0;
    else if (x < -0.5 * options[1]) sign = -1.0;
    if (commit) memory[0] = sign;
    return sign * options[0];
}

static double quantised(double x, double resolution)
{
    double count;
    if (resolution == 0.0) return x;
    count = x / resolution + 0.5;
    if (fabs(count) >= 4503599627370496.0) return x; /* finer than the last bit */
    return resolution * floor(count);
}

/* Draws are a hash of seed, element and number; its constants were found by Wellons ("lowbias32"). Signed
 * numbers of 64 bits, as in orchestrator/effects/draws.py: a number may be below zero. */
static int64_t mixed(int64_t state)
{
    state ^= state >> 16;
    state = (int64_t)(((uint64_t)state * 0x7FEB352Du) & 0xFFFFFFFFu);
    state ^= state >> 15;
    state = (int64_t)(((uint64_t)state * 0x846CA68Bu) & 0xFFFFFFFFu);
    return state ^ (state >> 16);
}

static int64_t seeded(const double *key, int64_t number)
{
    int64_t state = mixed(0x9E3779B9 ^ (int64_t)key[0]);
    state = mixed(state ^ (int64_t)key[1]);
    state = mixed(state ^ (int64_t)key[2]);
    state = mixed(state ^ (number & 0xFFFFFFFF));
    return mixed(state ^ (number >> 32));
}

static double uniform(const double *key, int64_t number)
{
    return ((double)seeded(key, number) + 0.5) / 4294967296.0;
}

static double normal(const double *key, int64_t number)
{
    int64_t first = seeded(key, number), second = mixed((first + 0x9E3779B9) & 0xFFFFFFFF);
    double one = ((double)first + 0.5) / 4294967296.0, other = ((double)second + 0.5) / 4294967296.0;
    return sqrt(-2.0 * log(one)) * cos(2.0 * PI * other);
}

static double noise(double time, double x, const double *options, double *memory, int commit)
{
    double start = memory[0] != 0.0 ? memory[1] : time, value;
    int64_t number;
    if (options[0] == 0.0) return x;
    number = (int64_t)floor((time - start) / options[1] + 1e-6);
    if (options[5] == 0.0 || memory[0] == 0.0) {
        value = normal(options + 2, number);
    } else {
        double keep = exp(-options[1] / options[5]);
        value = memory[3];
        for (int64_t each = (int64_t)memory[2] + 1; each <= number; each++)
            value = keep * value + sqrt(1.0 - keep * keep) * normal(options + 2, each);
    }
    if (commit) {
        memory[0] = 1.0;
        memory[1] = start;
        memory[2] = (double)number;
        memory[3] = value;
    }
    return x + options[0] * value;
}

static double drift(double time, double x, const double *options, double *memory, int commit)
{
    double start = memory[0] != 0.0 ? memory[1] : time;
    if (options[0] == 0.0) return x;
    if (commit) {
        memory[0] = 1.0;
        memory[1] = start;
    }
    return x + options[0] * (time - start);
}

static double dropout(double time, double x, const double *options, double *memory, int commit)
{
    double start = memory[0] != 0.0 ? memory[1] : time, y = x;
    int64_t number;
    if (options[0] == 0.0) return x;
    number = (int64_t)floor((time - start - options[2]) / options[1] + 1e-6);
    if (memory[0] != 0.0) {
        y = memory[3];
        if ((double)number > memory[2] && uniform(options + 3, number) >= options[0]) y = x;
    }
    if (commit) {
        memory[0] = 1.0;
        memory[1] = start;
        memory[2] = (double)number;
        memory[3] = y;
    }
    return y;
}

static double jitter(double time, double x, const double *options, double *memory, int n_memory, int commit)
{
    double start = memory[0] != 0.0 ? memory[n_memory - 1] : time, y;
    int64_t number;
    if (options[0] == 0.0) return x;
    number = (int64_t)floor((time - start - options[2]) / options[1] + 1e-6);
    if (number < 0) number = 0;
    y = earlier(time, x, options[0] * uniform(options + 3, number), options[0], 0, 0.0, memory, n_memory, commit);
    if (commit) memory[n_memory - 1] = start;
    return y;
}

/* x[0] is the signal, `commit` whether the instant is accepted, so that it is remembered. */
double effect_value(const Link *link, double time, const double *x, double *memory, int commit)
{
    const double *options = link->options;
    switch (link->kind) {
    case GAIN: return x[0] * options[0];
    case OFFSET: return options[0] == 0.0 ? x[0] : x[0] + options[0]; /* -0.0 + 0.0 is +0.0 */
    case DELAY:
        if (options[0] == 0.0) return x[0];
        return earlier(time, x[0], options[0], options[0], options[1] != 0.0, options[2], memory,
                       link->n_memory, commit);
    case LOW_PASS: return low_pass(time, x[0], options, memory, commit);
    case SAMPLE_AND_HOLD: return sample_and_hold(time, x[0], options, memory, commit);
    case SATURATE: return x[0] < options[0] ? options[0] : x[0] > options[1] ? options[1] : x[0];
    case QUANTISE: return quantised(x[0], options[0]);
    case RATE_LIMIT: return rate_limit(time, x[0], options, memory, commit);
    case DEAD_BAND:
        if (options[0] == 0.0) return x[0];
        if (x[0] > options[0]) return x[0] - options[0];
        return x[0] < -options[0] ? x[0] + options[0] : 0.0;
    case BACKLASH: return backlash(x[0], options, memory, commit);
    case NOISE: return noise(time, x[0], options, memory, commit);
    case DRIFT: return drift(time, x[0], options, memory, commit);
    case DROPOUT: return dropout(time, x[0], options, memory, commit);
    case JITTER: return jitter(time, x[0], options, memory, link->n_memory, commit);
    case MAP:
        for (int i = 0; i + 1 < link->n_options; i += 2)
            if (x[0] == options[i]) return options[i + 1];
        return x[0];
    case RELAY: return relay(x[0], options, memory, commit);
    default: return NAN;
    }
}
