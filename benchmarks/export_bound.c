/* The bound of benchmarks/export.py: the paper's two-layer controller written by hand.
 *
 * Two streams, widths 64-64 and 32-32, vector extensions of gcc: a block of rows stays in
 * registers over all columns, value and derivative share each weight, products are fused.
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
#define VECTORS 4
#define BLOCK (VECTORS * LENGTH)

typedef double vector __attribute__((vector_size(BYTES)));
typedef long long bits_vector __attribute__((vector_size(BYTES)));

static inline vector load(const double *from)
{
    vector v;
    memcpy(&v, from, sizeof v);
    return v;
}

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

/* The second layers, column by column; filled from the tables of necc.c when it is loaded. */
static double k_columns[65 * 64] __attribute__((aligned(64)));
static double hc_columns[33 * 32] __attribute__((aligned(64)));

static void spread(const double *w, int rows, double *columns)
{
    memcpy(columns, w, (size_t)rows * sizeof *w);
    for (int j = 0; j < rows; ++j)
        for (int i = 0; i < rows; ++i)
            columns[rows * (1 + j) + i] =
                w[rows + j / 4 * 4 * rows + i / LANES * 4 * LANES + j % 4 * LANES + i % LANES];
}

static void __attribute__((constructor)) spread_all(void)
{
    spread(k_w2, 64, k_columns);
    spread(hc_w2, 32, hc_columns);
}

/* in and out alternate value and derivative. */
static inline __attribute__((always_inline)) void hidden(const double *w, int rows, int columns,
                                                         const double *in, double *out)
{
    for (int p = 0; p < rows; p += BLOCK) {
        vector a[VECTORS], t[VECTORS];
        const double *column = w + rows + p;
        for (int i = 0; i < VECTORS; ++i) {
            a[i] = load(w + p + i * LENGTH);
            t[i] = (vector){0};
        }
        for (int j = 0; j < columns; ++j, column += rows)
            for (int i = 0; i < VECTORS; ++i) {
                const vector v = load(column + i * LENGTH);
                a[i] += v * in[2 * j];
                t[i] += v * in[2 * j + 1];
            }
        for (int i = 0; i < VECTORS; ++i) {
            const vector value = fast_tanh(a[i]), slope = t[i] * (1.0 - value * value);
            for (int k = 0; k < LENGTH; ++k) {
                out[2 * (p + i * LENGTH + k)] = value[k];
                out[2 * (p + i * LENGTH + k) + 1] = slope[k];
            }
        }
    }
}

static inline double last_slope(const double *w, int columns, const double *in)
{
    double sum[4] = {0};
    for (int j = 0; j < columns; j += 4)
        for (int k = 0; k < 4; ++k)
            sum[k] += w[j + k] * in[2 * (j + k) + 1];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

void run(const double *x, const double *xi, double *u, double *xidot);
void run(const double *x, const double *xi, double *u, double *xidot)
{
    double a[128], b[128], grad_hc[1], gamma[1];
    const double c[2] = {x[0] - xi[0], 1.0}, h[2] = {xi[0], 1.0};
    hidden(k_w1, 64, 1, c, a);
    hidden(k_columns, 64, 64, a, b);
    gamma[0] = last_slope(k_w3, 64, b);
    hidden(hc_w1, 32, 1, h, a);
    hidden(hc_columns, 32, 32, a, b);
    grad_hc[0] = last_slope(hc_w3, 32, b);
    control_law(x, xi, grad_hc, gamma, u, xidot);
}
