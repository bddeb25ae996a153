/* The bound of benchmarks/export.py: the paper's two-layer controller written by hand.
 *
 * Two streams, widths 64-64 and 32-32, vector extensions of gcc: a block of rows stays in
 * registers over all columns, value and derivative share each weight, products are fused, weights
 * begin a cache line, and the last layer takes its vectors before they leave the registers.
 * Not portable, no other widths: it says how far the emitted code is from what this machine does.
 */
#include "necc.c"

#if defined(__AVX512F__)
#define BYTES 64
#elif defined(__AVX__)
#define BYTES 32
#else
#define BYTES 16
#endif
#define LENGTH (BYTES / 8)

typedef double vector __attribute__((vector_size(BYTES)));
typedef long long bits_vector __attribute__((vector_size(BYTES)));

static inline vector load(const double *from)
{
    vector v;
    memcpy(&v, from, sizeof v);
    return v;
}

static inline void store(double *to, vector v) { memcpy(to, &v, sizeof v); }

static inline vector least(vector a, vector b)
{
    const bits_vector mask = a < b;
    return (vector)((mask & (bits_vector)a) | (~mask & (bits_vector)b));
}

static inline vector fast_tanh(vector x)
{
    const double shift = 6755399441055744.0;
    const vector limit = (vector){0} + 20.0;
    x = least(x, limit);
    x = -least(-x, limit);
    const vector rounded = x * 2.8853900817779268 + shift;
    const vector r = x - (rounded - shift) * 0.34657359027997264;
    const vector scale = (vector)(((bits_vector)rounded + 1023) << 52);
    const vector s = r * r;
    const vector N = r * (135135.0 + s * (17325.0 + s * (378.0 + s)));
    const vector D = 135135.0 + s * (62370.0 + s * (3150.0 + s * 28.0));
    const vector plus = scale + 1.0, minus = scale - 1.0;
    return (minus * D + plus * N) / (plus * D + minus * N);
}

/* The tables of necc.c of the second layers, at the beginning of a cache line. */
static double k_columns[65 * 64] __attribute__((aligned(64)));
static double hc_columns[33 * 32] __attribute__((aligned(64)));

static void __attribute__((constructor)) copy_columns(void)
{
    memcpy(k_columns, k_w2, sizeof k_columns);
    memcpy(hc_columns, hc_w2, sizeof hc_columns);
}

/* Value and derivative of the first hidden layer, from the scalar v. */
static inline __attribute__((always_inline)) void first(const double *w, int rows, double v,
                                                        double *value, double *slope)
{
    for (int p = 0; p < rows; p += LENGTH) {
        const vector column = load(w + rows + p), t = fast_tanh(load(w + p) + column * v);
        store(value + p, t);
        store(slope + p, column * (1.0 - t * t));
    }
}

/* f(a) and its derivative along t, times the weights of the last layer. */
static inline vector hidden(const double *last, vector a, vector t)
{
    const vector f = fast_tanh(a);
    return load(last) * (t * (1.0 - f * f));
}

/* Derivative of the output from the two streams of the first hidden layer; four vectors of rows
 * at a time, whose eight sums stay in registers over all columns.
 */
static inline __attribute__((always_inline)) double second(const double *w, const double *last,
                                                           int rows, const double *value,
                                                           const double *slope)
{
    vector sum = {0};
    double parts[LENGTH], total = 0;
    for (int p = 0; p < rows; p += 4 * LENGTH) {
        vector a0 = load(w + p), a1 = load(w + p + LENGTH);
        vector a2 = load(w + p + 2 * LENGTH), a3 = load(w + p + 3 * LENGTH);
        vector t0 = {0}, t1 = {0}, t2 = {0}, t3 = {0};
        const double *column = w + rows + p;
        for (int j = 0; j < rows; ++j, column += rows) {
            const vector v = (vector){0} + value[j], s = (vector){0} + slope[j];
            const vector c0 = load(column), c1 = load(column + LENGTH);
            const vector c2 = load(column + 2 * LENGTH), c3 = load(column + 3 * LENGTH);
            a0 += c0 * v, a1 += c1 * v, a2 += c2 * v, a3 += c3 * v;
            t0 += c0 * s, t1 += c1 * s, t2 += c2 * s, t3 += c3 * s;
        }
        last += 4 * LENGTH;
        sum += hidden(last - 4 * LENGTH, a0, t0) + hidden(last - 3 * LENGTH, a1, t1)
             + hidden(last - 2 * LENGTH, a2, t2) + hidden(last - LENGTH, a3, t3);
    }
    store(parts, sum);
    for (int k = 0; k < LENGTH; ++k)
        total += parts[k];
    return total;
}

void run(const double *x, const double *xi, double *u, double *xidot);
void run(const double *x, const double *xi, double *u, double *xidot)
{
    double value[64], slope[64], grad_hc[1], gamma[1];
    first(k_w1, 64, x[0] - xi[0], value, slope);
    gamma[0] = second(k_columns, k_w3, 64, value, slope);
    first(hc_w1, 32, xi[0], value, slope);
    grad_hc[0] = second(hc_columns, hc_w3, 32, value, slope);
    control_law(x, xi, grad_hc, gamma, u, xidot);
}
