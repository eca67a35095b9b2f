/* A chain of masses on springs that stiffen, by the pair of Dormand and Prince: what one would write by hand. */
#include <math.h>
#include <string.h>

enum { MASSES = 8, N = 2 * MASSES };

static void slopes(const double *y, double *f)
{
    for (int k = 0; k < MASSES; k++) {
        double left = y[k] - (k ? y[k - 1] : 0), right = (k + 1 < MASSES ? y[k + 1] : 0) - y[k];
        f[k] = y[MASSES + k];
        f[MASSES + k] = right + right * right * right - left - left * left * left;
    }
}

static const double A[7][6] = {{0},
                               {1.0 / 5},
                               {3.0 / 40, 9.0 / 40},
                               {44.0 / 45, -56.0 / 15, 32.0 / 9},
                               {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
                               {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
                               {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}};
static const double E[7] = {71.0 / 57600,      0,          -71.0 / 16695, 71.0 / 1920,
                            -17253.0 / 339200, 22.0 / 525, -1.0 / 40};

/* Integrates y from 0 to `end`; returns the number of steps. */
int integrate(double *y, double end, double tolerance)
{
    double k[7][N], stage[N], t = 0, h = 1e-3;
    int steps = 0;
    slopes(y, k[0]);
    while (t < end) {
        double norm = 0;
        if (t + h > end) h = end - t;
        for (int s = 1; s < 7; s++) {
            for (int i = 0; i < N; i++) {
                double sum = 0;
                for (int r = 0; r < s; r++) sum += A[s][r] * k[r][i];
                stage[i] = y[i] + h * sum;
            }
            slopes(stage, k[s]);
        }
        for (int i = 0; i < N; i++) {
            double error = 0;
            for (int s = 0; s < 7; s++) error += E[s] * k[s][i];
            norm = fmax(norm, fabs(h * error) / (tolerance * (1e-3 + fmax(fabs(y[i]), fabs(stage[i])))));
        }
        steps++;
        if (norm <= 1) {
            t += h;
            memcpy(y, stage, sizeof stage);
            memcpy(k[0], k[6], sizeof k[0]);
        }
        h *= fmin(5, fmax(0.2, 0.9 * pow(fmax(norm, 1e-10), -0.2)));
    }
    return steps;
}
