/* Times controllers side by side: each argument is a shared library with `run`.
 *
 * Rounds go through all libraries in turn, so that a disturbance meets them alike; the best block
 * of each counts. Prints one line per library: ns per call and a sum that shows they agree.
 */
#define _POSIX_C_SOURCE 199309L
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define CALLS 500

typedef void controller(const double *x, const double *xi, double *u, double *xidot);

static double seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
    controller *run[32];
    double best[32], sum[32], u[1], xidot[1], x[2] = {0.3, 0.1};
    const double xi[1] = {0.2};
    const int rounds = atoi(argv[1]), count = argc - 2;
    for (int i = 0; i < count; ++i) {
        void *library = dlopen(argv[i + 2], RTLD_NOW | RTLD_LOCAL);
        void *symbol = library == NULL ? NULL : dlsym(library, "run");
        if (symbol == NULL)
            return fprintf(stderr, "%s\n", dlerror()), 1;
        memcpy(&run[i], &symbol, sizeof symbol);
        best[i] = 1e9;
    }
    for (int round = 0; round < rounds; ++round)
        for (int i = 0; i < count; ++i) {
            const double began = seconds();
            sum[i] = 0;
            for (int call = 0; call < CALLS; ++call) {
                x[0] = 0.002 * call;
                run[i](x, xi, u, xidot);
                sum[i] += u[0] + xidot[0];
            }
            const double took = (seconds() - began) / CALLS;
            best[i] = took < best[i] ? took : best[i];
        }
    for (int i = 0; i < count; ++i)
        printf("%.1f %.15g\n", 1e9 * best[i], sum[i]);
    return 0;
}
