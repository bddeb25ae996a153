"""The networks of the emitted C to the last bit: the order that is documented, in NumPy."""

import ctypes
import subprocess

import numpy as np
import pytest
from helpers.export_cases import COMPILERS
from numpy.testing import assert_array_equal

from necc_casadi.export.casadi2c import Real
from necc_casadi.export.compiled import compile_shared
from necc_casadi.export.networks import c_network, kernels, loop_sizes
from necc_casadi.export.templating import fill
from necc_casadi.lyapunov.networks import Network

PREAMBLE = """
#include <math.h>
#include <stdint.h>
#include <string.h>
typedef {real} necc_real;
#define R(literal) {literal}
{sizes}
{tables}
{kernels}
{function}
necc_real run(const necc_real *v, necc_real *slope);
necc_real run(const necc_real *v, necc_real *slope) {{ return hc_network(v, slope); }}
"""
#: 1.5 2^digits, 2/ln 2, ln2/2 in two parts, bias and place of the exponent, where tanh is 1.
TANH = {
    "double": (6755399441055744.0, 2.8853900817779268, 0.3465735902799665, 6.17333302073885e-15,
               1023, 52, 20.0),
    "float": (12582912.0, 2.88539, 0.34657288, 7.143034e-07, 127, 23, 10.0),
}  # fmt: skip


def tanh(a, real):
    """tanh and its slope as ``tanh_double.c`` and ``tanh_float.c`` say."""
    kind, bits = (np.float64, np.uint64) if real == "double" else (np.float32, np.uint32)
    shift, gain, high, low, bias, place, end = TANH[real]
    shift, gain, high, low = (kind(v) for v in (shift, gain, high, low))
    x = np.clip(a, kind(-end), kind(end))
    rounded = x * gain + shift
    n = rounded - shift
    r = (x - n * high) - n * low
    scale = ((rounded.view(bits) + bits(bias)) << bits(place)).view(kind)
    s = r * r
    if real == "double":
        N = r * (kind(135135) + s * (kind(17325) + s * (kind(378) + s)))
        D = kind(135135) + s * (kind(62370) + s * (kind(3150) + s * kind(28)))
    else:
        N, D = r * (kind(15) + s), kind(15) + s * kind(6)
    plus, minus = scale + kind(1), scale - kind(1)
    t = (minus * D + plus * N) / (plus * D + minus * N)
    return t, kind(1) - t * t


def columns(W, v):
    """W v, four columns at a time."""
    total = np.zeros(len(W), W.dtype)
    for j in range(0, W.shape[1], 4):
        p = [W[:, j + i] * v[j + i] for i in range(4)]
        total = total + ((p[0] + p[1]) + (p[2] + p[3]))
    return total


def dot(w, v):
    """Sixteen partial sums, added in halves."""
    sums = np.zeros(16, w.dtype)
    for j in range(0, len(w), 16):
        sums = sums + w[j : j + 16] * v[j : j + 16]
    while len(sums) > 1:
        half = len(sums) // 2
        sums = sums[:half] + sums[half:]
    return sums[0]


def padded(W, b, first, last):
    up = lambda n: -(-n // 16) * 16  # noqa: E731
    rows, cols = (1 if last else up(len(W))), (W.shape[1] if first else up(W.shape[1]))
    bigger, bias = np.zeros((rows, cols)), np.zeros(rows)
    bigger[: W.shape[0], : W.shape[1]], bias[: len(b)] = W, b
    return bigger, bias


def network(layers, v, real):
    """Value and gradient, every operation rounded to the type."""
    kind = np.float64 if real == "double" else np.float32
    layers = [padded(W, b, i == 0, i == len(layers) - 1) for i, (W, b) in enumerate(layers)]
    layers = [(W.astype(kind), b.astype(kind)) for W, b in layers]
    (W, a), *rest, (last, bias) = layers
    for i, component in enumerate(v):
        a = a + W[:, i] * kind(component)
    a, slope = tanh(a, real)
    streams = [W[:, i] * slope for i in range(len(v))]
    for W, b in rest:
        value = columns(W, a) + b
        streams = [columns(W, stream) for stream in streams]
        a, slope = tanh(value, real)
        streams = [stream * slope for stream in streams]
    return dot(last[0], a) + bias[0], [dot(last[0], stream) for stream in streams]


def compiled(folder, net, weights, real, compiler, flags):
    """``hc_network`` of these weights as a function of v."""
    number, network_c = Real(real), c_network("hc", net, weights)
    text = PREAMBLE.format(
        real=real,
        literal=f"literal##{number.suffix}" if number.suffix else "literal",
        sizes=loop_sizes([network_c]),
        tables=network_c.tables(number),
        kernels=kernels([network_c], number),
        function=network_c.function(number),
    )
    (folder / "network.c").write_text(text)
    target = folder / f"{compiler}{len(flags)}.so"
    compile_shared(compiler, [folder / "network.c"], target, flags)
    kind = ctypes.c_double if real == "double" else ctypes.c_float
    run = ctypes.CDLL(str(target)).run
    run.restype = kind

    def value_and_gradient(v):
        slope = (kind * len(v))()
        return run((kind * len(v))(*v), slope), list(slope)

    return value_and_gradient


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("flags", [["-O1"], ["-O3", "-march=native"]], ids=["O1", "O3"])
@pytest.mark.parametrize("inputs", [1, 2, 3])
def test_networks_round_in_the_documented_order(tmp_path, compiler, real, flags, inputs):
    net = Network(inputs, (40, 20, 33))
    rng = np.random.default_rng(inputs)
    weights = net.initial(rng)
    run = compiled(tmp_path, net, weights, real, compiler, flags)
    for _ in range(20):
        v = rng.normal(scale=2, size=inputs).astype(np.float32).astype(float)
        value, gradient = run(v)
        expected, slopes = network(net.layers(weights), v, real)
        assert value == expected
        assert_array_equal(gradient, slopes)


EVERY_FLOAT = """
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
typedef float necc_real;
#define LANES 32
{function}
int main(void)
{{
    double worst = 0, worst_slope = 0;
    for (uint32_t bits = {first}u; bits <= {last}u; bits += LANES / 2) {{
        float x[LANES], a[LANES], slope[LANES];
        for (uint32_t k = 0; k < LANES; ++k) {{
            const uint32_t each = (bits + k / 2) | (k % 2) << 31;
            memcpy(x + k, &each, sizeof each);
        }}
        memcpy(a, x, sizeof x);
        activate_{name}(a, slope);
        for (int k = 0; k < LANES; ++k) {{
            const double exact = {name}((double)x[k]);
            const double error = fabs(a[k] - exact) / {unit};
            const double slope_error = fabs(slope[k] - ({slope}));
            worst = error > worst ? error : worst;
            worst_slope = slope_error > worst_slope ? slope_error : worst_slope;
        }}
    }}
    printf("%.9g %.9g", ldexp(worst, 23), ldexp(worst_slope, 23));
    return 0;
}}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "end", "unit", "slope", "value_error", "slope_error"),
    [
        ("tanh", 10.5, "fabs(exact)", "1 - exact * exact", 2.16, 3.64),
        ("sin", 100.0, "1", "cos((double)x[k])", 0.92, 0.92),
    ],
)
def test_activations_in_float_at_every_number(
    tmp_path, name, end, unit, slope, value_error, slope_error
):
    """From 2⁻¹⁴, below which tanh x and sin x are multiples of x, to where tanh is 1."""
    first, last = (int(np.float32(v).view(np.uint32)) for v in (2.0**-14, end))
    text = EVERY_FLOAT.format(
        function=fill(f"{name}_float.c"), name=name, unit=unit, slope=slope, first=first, last=last
    )
    (tmp_path / "every.c").write_text(text)
    command = [COMPILERS[0], "-std=c99", "-O3", "-march=native", "-ffp-contract=off"]
    program = str(tmp_path / "every")
    subprocess.run([*command, str(tmp_path / "every.c"), "-o", program, "-lm"], check=True)
    done = subprocess.run([program], check=True, capture_output=True, text=True)
    value, derivative = (float(v) for v in done.stdout.split())
    assert 0.5 < value <= value_error
    assert 0.5 < derivative <= slope_error
