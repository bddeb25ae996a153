"""Cost of one call of the controller: the emitted C, CasADi's, a hand-tuned bound, Python peers.

    python benchmarks/export.py [--rounds N] [--no-peers] [--no-cortex]

All compiled variants are timed in turn in one process, the best block of each counts: quote the
ratios. Peers that are not installed are left out of the table, and said to be.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib.util
import platform
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.design import Design
from necc_casadi.export.c_project import export_c
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import make_plant
from necc_casadi.verdict.judge import judge

HERE = Path(__file__).parent
STRICT = ["-std=c99", "-ffp-contract=off"]
NATIVE = ["-O3", "-march=native"]
AVX2 = ["-O3", "-mavx2", "-mfma"]
ARM = ["-mthumb", "-mfloat-abi=hard"]
#: (core, type) -> flags and the emulated board.
CORES = {
    ("M4F", "float"): (["-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"], "mps2-an386"),
    ("M7", "float"): (["-mcpu=cortex-m7", "-mfpu=fpv5-d16"], "mps2-an500"),
    ("M7", "double"): (["-mcpu=cortex-m7", "-mfpu=fpv5-d16"], "mps2-an500"),
}
QEMU = [
    "qemu-system-arm", "-nographic", "-monitor", "none", "-serial", "none",
    "-icount", "shift=0", "-semihosting-config", "enable=on,target=native", "-kernel",
]  # fmt: skip
POINT = (np.array([0.3, 0.1]), np.array([0.2]))
#: Figures measured elsewhere, for comparison: ns on x86-64 with AVX2, gcc 12.
ELSEWHERE = {
    "d2 emitted, -O2": 4198, "d2 emitted, -O3 native, no contraction": 1250,
    "d2 emitted, -O3 native": 1025, "d2 emitted, float, -O3 native": 675,
    "d2 hand-tuned bound": 977, "d2 CasADi MX, -O2": 13949, "d2 CasADi MX, -O3 native": 13478,
    "d2 CasADi SX, -O2": 9881, "d2 CasADi SX, -O3 native": 9975,
    "d1 emitted, -O2": 1173, "d1 emitted, -O3 native": 321, "d1 CasADi MX, -O2": 1576,
}  # fmt: skip


def paper_controller(hidden_h: tuple[int, ...], hidden_k: tuple[int, ...]) -> Design:
    """The paper's pendulum with random weights: time does not depend on them."""
    q, p = x = sp.symbols("q p", real=True)
    J = sp.Matrix([[0, 1], [-1, 0]])
    plant = make_plant(x, J, sp.zeros(2, 2), sp.Matrix([0, 1]), p**2 / 2 + 1 - sp.cos(q))
    loop = interconnect(plant, default_controller(plant))
    casimirs = Casimirs((q - loop.controller.xi[0],), 1, 1)
    target = {q: sp.pi / 4, p: sp.Integer(0)}
    form = Form(Network(1, hidden_h), Network(1, hidden_k))
    return Design(
        loop=loop, casimirs=casimirs, x_star=tuple(target.values()),
        verdict=judge(loop, casimirs, target), form=form,
        weights=form.initial(np.random.default_rng(0)), xi_star=np.array([0.3]),
        damping=np.diag([5.0, 6.0]), a=0.5, a_requested=0.5, seed=0,
    )  # fmt: skip


DESIGNS = {"d2": paper_controller((32, 32), (64, 64)), "d1": paper_controller((32,), (64,))}

# --- compiled variants ----------------------------------------------------------------------------

EMITTED = """
#include "necc.c"
void run(const double *x, const double *xi, double *u, double *xidot);
void run(const double *x, const double *xi, double *u, double *xidot)
{
    const necc_real fx[2] = {(necc_real)x[0], (necc_real)x[1]}, fxi[1] = {(necc_real)xi[0]};
    necc_real fu[1], fd[1];
    necc_control(fx, fxi, fu, fd);
    u[0] = (double)fu[0], xidot[0] = (double)fd[0];
}
"""
GENERATED = """
#include "law.c"
void run(const double *x, const double *xi, double *u, double *xidot);
void run(const double *x, const double *xi, double *u, double *xidot)
{
    const casadi_real *arg[law_SZ_ARG] = {x, xi};
    casadi_real *res[law_SZ_RES] = {u, xidot};
    casadi_int iw[law_SZ_IW + 1];
    casadi_real w[law_SZ_W + 1];
    law(arg, res, iw, w, 0);
}
"""


def compile_to(target: Path, source: Path, flags: list[str]) -> float:
    """Compile a shared library; the seconds it took."""
    began = time.perf_counter()
    subprocess.run(
        ["gcc", *flags, "-w", "-fPIC", "-shared", str(source), "-o", str(target), "-lm"], check=True
    )
    return time.perf_counter() - began


def text_size(library: Path) -> int:
    """Bytes of code and constants."""
    printed = subprocess.run(["size", str(library)], check=True, capture_output=True, text=True)
    return int(printed.stdout.splitlines()[1].split()[0])


def casadi_law(design: Design, expand: bool) -> ca.Function:
    """The control law as one function for CasADi's code generator."""
    law = design.lyapunov.control_law_function
    return law.expand("law") if expand else ca.Function("law", law.mx_in(), law.call(law.mx_in()))


def casadi_source(design: Design, folder: Path, expand: bool) -> Path:
    """CasADi's own C for the control law."""
    law = casadi_law(design, expand)
    folder.mkdir()
    options = {"with_header": True, "verbose": False, "casadi_int": "int"}
    law.generate("law.c", options | {"with_mem": False})
    Path("law.c").rename(folder / "law.c")
    Path("law.h").unlink()
    header = "".join(
        f"#define law_SZ_{name} {size}\n"
        for name, size in zip(
            ("ARG", "RES", "IW", "W"),
            (law.sz_arg(), law.sz_res(), law.sz_iw(), law.sz_w()),
            strict=True,
        )
    )
    (folder / "run.c").write_text(header + GENERATED)
    return folder / "run.c"


def variants(folder: Path) -> Iterator[tuple[str, Path, list[str]]]:
    """(label, source, flags) of every compiled variant."""
    fused = ["-ffp-contract=fast"]
    for name, design in DESIGNS.items():
        for real in ("double", "float"):
            emitted = folder / f"{name}_{real}"
            export_c(design, emitted, real=real, measured=False)
            (emitted / "run.c").write_text(EMITTED)
            kind = "emitted" if real == "double" else "emitted, float"
            yield f"{name} {kind}, -O2", emitted / "run.c", [*STRICT, "-O2"]
            yield (
                f"{name} {kind}, -O3 native, no contraction",
                emitted / "run.c",
                [*STRICT, *NATIVE],
            )
            yield f"{name} {kind}, -O3 native", emitted / "run.c", NATIVE
            if platform.machine() == "x86_64":
                yield f"{name} {kind}, -O3 AVX2", emitted / "run.c", AVX2
        for expand in (False, True):
            kind = "CasADi SX" if expand else "CasADi MX"
            generated = casadi_source(design, folder / f"{name}_{kind[-2:]}", expand)
            yield f"{name} {kind}, -O2", generated, ["-O2"]
            yield f"{name} {kind}, -O3 native", generated, NATIVE
            yield f"{name} {kind}, -O3 native, fast-math", generated, [*NATIVE, "-ffast-math"]
    bound = folder / "d2_double" / "bound.c"
    shutil.copy(HERE / "export_bound.c", bound)
    quick = ["-fno-math-errno", "-fno-trapping-math"]
    yield "d2 hand-tuned bound", bound, ["-std=gnu11", *NATIVE, *fused, *quick]


def time_compiled(folder: Path, rounds: int) -> dict[str, float]:
    """ns per call of every compiled variant, timed in turn; prints sizes."""
    driver = folder / "timing"
    subprocess.run(
        ["gcc", "-std=gnu11", "-O2", str(HERE / "export_timing.c"), "-o", str(driver), "-ldl"],
        check=True,
    )
    labels, libraries = [], []
    for index, (label, source, flags) in enumerate(variants(folder)):
        library = folder / f"v{index}.so"
        seconds = compile_to(library, source, flags)
        print(
            f"{label:42s} {text_size(library) / 1024:6.1f} KB of text and rodata, "
            f"compiled in {seconds:.1f} s"
        )
        labels.append(label)
        libraries.append(str(library))
    done = subprocess.run(
        [str(driver), str(rounds), *libraries], check=True, capture_output=True, text=True
    )
    rows = [line.split() for line in done.stdout.splitlines()]
    for name in DESIGNS:
        sums = [float(s) for label, (_, s) in zip(labels, rows, strict=True)
                if label.startswith(name) and "float" not in label]  # fmt: skip
        if np.ptp(sums) > 1e-9 * abs(sums[0]):
            raise SystemExit(f"the variants of {name} disagree: {sums}")
    return {label: float(ns) for label, (ns, _) in zip(labels, rows, strict=True)}


# --- peers called from Python ---------------------------------------------------------------------


def forward(design: Design, tanh: Callable, asarray: Callable) -> Callable:
    """(x, ξ) -> (u, ξ̇) in the arrays of any library; f′ carried forward."""
    form = design.form
    theta_h, theta_k = form.split(design.weights)
    nets = [
        [(asarray(W), asarray(b)) for W, b in net.layers(theta)]
        for net, theta in ((form.hc, theta_h), (form.k, theta_k))
    ]

    def slope(layers, v):
        value, derivative = v, None
        for W, b in layers[:-1]:
            value = tanh(W @ value + b)
            product = W[:, 0] if derivative is None else W @ derivative
            derivative = (1 - value * value) * product
        return (layers[-1][0] @ derivative)[0]

    def law(x, xi):
        dh, dk = slope(nets[0], xi), slope(nets[1], x[:1] - xi)
        return -dh - 5 * x[1], x[1] - 6 * (dh - dk)

    return law


def casadi_peers(design: Design, folder: Path) -> Iterator[tuple[str, Callable[[], object]]]:
    """CasADi's virtual machine, and its compiled code through buffer()."""
    law = design.lyapunov.control_law_function
    yield "CasADi Function", lambda: law(*POINT)
    casadi_law(design, expand=True).generate("law.c")
    compile_to(folder / "law.so", Path("law.c"), NATIVE)
    Path("law.c").unlink()
    external = ca.external("law", str(folder / "law.so"))
    buffer, trigger = external.buffer()
    arrays = [*POINT, np.zeros(1), np.zeros(1)]
    buffer.set_arg(0, memoryview(arrays[0]))
    buffer.set_arg(1, memoryview(arrays[1]))
    buffer.set_res(0, memoryview(arrays[2]))
    buffer.set_res(1, memoryview(arrays[3]))
    yield "CasADi .so through buffer()", trigger
    yield "", lambda: (buffer, arrays, external)  # keeps them alive


def torch_peer(design: Design) -> Callable[[], object]:
    """PyTorch eager: ∂V/∂z by autograd, as in the published code."""
    import torch

    torch.set_num_threads(1)
    form = design.form
    nets = [
        [(torch.tensor(W), torch.tensor(b)) for W, b in net.layers(theta)]
        for net, theta in zip((form.hc, form.k), form.split(design.weights), strict=True)
    ]

    def energy(layers, v):
        for W, b in layers[:-1]:
            v = torch.tanh(torch.nn.functional.linear(v, W, b))
        return torch.nn.functional.linear(v, *layers[-1])[0]

    def law():
        x = torch.tensor(POINT[0], requires_grad=True)
        xi = torch.tensor(POINT[1], requires_grad=True)
        hc = energy(nets[0], xi)
        V = x[1] ** 2 / 2 + 1 - torch.cos(x[0]) + hc + energy(nets[1], x[:1] - xi)
        (grad_hc,) = torch.autograd.grad(hc, xi, retain_graph=True)
        V_x, V_xi = torch.autograd.grad(V, (x, xi))
        return -grad_hc - 5 * V_x[1], x[1] - 6 * V_xi

    return law


def numba_peer(design: Design) -> Callable[[], object]:
    """numba, compiled ahead of the timing."""
    import numba

    (H1, h1), *hs = design.form.hc.layers(design.form.split(design.weights)[0])
    (K1, k1), *ks = design.form.k.layers(design.form.split(design.weights)[1])
    (H2, h2), (H3, _) = hs
    (K2, k2), (K3, _) = ks

    @numba.njit
    def slope(W1, b1, W2, b2, W3, v):
        a = np.tanh(W1[:, 0] * v + b1)
        t = (1 - a * a) * W1[:, 0]
        value = np.tanh(W2 @ a + b2)
        return np.dot(W3[0], (1 - value * value) * (W2 @ t))

    @numba.njit
    def law(x, xi):
        dh = slope(H1, h1, H2, h2, H3, xi[0])
        dk = slope(K1, k1, K2, k2, K3, x[0] - xi[0])
        return -dh - 5 * x[1], x[1] - 6 * (dh - dk)

    return lambda: law(*POINT)


def jax_peer(design: Design) -> Callable[[], object]:
    """JAX, jit with float64."""
    import jax

    jax.config.update("jax_enable_x64", True)
    law = jax.jit(forward(design, jax.numpy.tanh, jax.numpy.asarray))
    point = [jax.numpy.asarray(v) for v in POINT]
    return lambda: jax.block_until_ready(law(*point))


def onnx_peer(design: Design) -> Callable[[], object]:
    """onnxruntime on the closed-form law as a graph of float64."""
    import onnx
    import onnxruntime
    from onnx import helper, numpy_helper

    nodes, constants = [], []

    def constant(name, value):
        constants.append(numpy_helper.from_array(np.asarray(value, float), name))
        return name

    def node(kind, *inputs, **attributes):
        name = f"n{len(nodes)}"
        nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def slope(tag, layers, v):
        value, derivative = v, None
        one = constant(f"{tag}_one", 1.0)
        for i, (W, b) in enumerate(layers[:-1]):
            w = constant(f"{tag}{i}_w", W.T)
            value = node("Tanh", node("Gemm", value, w, constant(f"{tag}{i}_b", b)))
            factor = node("Sub", one, node("Mul", value, value))
            product = w if derivative is None else node("MatMul", derivative, w)
            derivative = node("Mul", factor, product)
        return node("MatMul", derivative, constant(f"{tag}_last", layers[-1][0].T))

    form = design.form
    theta_h, theta_k = form.split(design.weights)
    dh = slope("h", form.hc.layers(theta_h), "xi")
    dk = slope("k", form.k.layers(theta_k), node("Sub", "q", "xi"))
    u = node("Neg", node("Add", dh, node("Mul", constant("D", 5.0), "p")))
    pull = node("Mul", constant("Dc", 6.0), node("Sub", dh, dk))
    xi_dot = node("Sub", "p", pull)
    values = [helper.make_tensor_value_info(n, onnx.TensorProto.DOUBLE, [1, 1])
              for n in ("q", "p", "xi", u, xi_dot)]  # fmt: skip
    graph = helper.make_graph(nodes, "law", values[:3], values[3:], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model.SerializeToString(), options)
    (q, p), (xi,) = POINT
    feed = {name: np.array([[v]]) for name, v in (("q", q), ("p", p), ("xi", xi))}
    return lambda: session.run(None, feed)


def loaded_peer(folder: Path) -> Callable[[], object]:
    """The emitted C through ctypes with arrays prepared once."""
    from necc_casadi.export.compiled import load_controller

    compiled = load_controller(folder, flags=NATIVE)
    arrays = [(ctypes.c_double * n)(*v) for n, v in ((2, POINT[0]), (1, POINT[1]))]
    results = [(ctypes.c_double * 1)() for _ in range(2)]
    function = compiled.library.necc_control
    return lambda: function(*arrays, *results)


def time_peers(folder: Path) -> dict[str, float]:
    """µs per call from Python of d2, the best of several blocks; checks each against CasADi."""
    design = DESIGNS["d2"]
    calls: dict[str, Callable[[], object]] = {
        "emitted C through ctypes": loaded_peer(folder / "d2_double"),
        "numpy": (lambda law: lambda: law(*POINT))(forward(design, np.tanh, np.asarray)),
    }
    calls |= dict(casadi_peers(design, folder))
    for name, module, make in (
        ("torch eager autograd", "torch", torch_peer), ("numba", "numba", numba_peer),
        ("JAX jit", "jax", jax_peer), ("onnxruntime", "onnxruntime", onnx_peer),
    ):  # fmt: skip
        if importlib.util.find_spec(module) is None:
            print(f"{name}: not installed")
        else:
            calls[name] = make(design)
    expected = np.concatenate(design.control(*POINT))
    times = {}
    for name, call in calls.items():
        if not name:
            continue
        result = call()
        if isinstance(result, (tuple, list)):
            got = [
                float(np.asarray(getattr(v, "detach", lambda v=v: v)()).ravel()[0]) for v in result
            ]
            np.testing.assert_allclose(got, expected, rtol=1e-9)
        times[name] = min(_blocks(call)) * 1e6
    return times


def _blocks(call: Callable[[], object]) -> Iterator[float]:
    for _ in range(30):
        began = time.perf_counter()
        for _ in range(50):
            call()
        yield (time.perf_counter() - began) / 50


# --- Cortex-M4F and M7 under emulation ------------------------------------------------------------


def cortex(folder: Path) -> Iterator[tuple[str, str, str, str, list[str]]]:
    """Design, optimisation, core, type, [instructions, stack, flash, bss, same bits as here]."""
    for name in DESIGNS:
        for (core, real), (unit, board) in CORES.items():
            source = folder / f"{name}_{real}"
            host = _host_hash(source, real)
            for level in ("-O2", "-O3"):
                flags = ["-std=gnu99", "-ffp-contract=off", level, *ARM, *unit]
                yield name, level, core, real, _on_board(source, flags, board, host)


def _on_board(source: Path, flags: list[str], board: str, host: str) -> list[str]:
    target, compiled = source / "cortex.elf", source / "necc.o"
    subprocess.run(
        ["arm-none-eabi-gcc", *flags, f"-I{source}", str(source / "necc.c"),
         str(HERE / "export_cortex_m.c"), "-nostartfiles", "-T",
         str(HERE / "export_cortex_m.ld"), "-ffunction-sections", "-Wl,--gc-sections",
         "-o", str(target), "-lm"],
        check=True,
    )  # fmt: skip
    run = subprocess.run(
        [*QEMU, str(target), "-M", board], check=True, capture_output=True, text=True, timeout=120
    )
    instructions, stack, bits = (run.stdout + run.stderr).split()[:3]
    subprocess.run(
        ["arm-none-eabi-gcc", *flags, "-c", str(source / "necc.c"), "-o", str(compiled)],
        check=True,
    )
    printed = subprocess.run(
        ["arm-none-eabi-size", str(compiled)], check=True, capture_output=True, text=True
    ).stdout
    text, data, bss = printed.splitlines()[1].split()[:3]
    same = "yes" if bits == host else "NO"
    return [instructions, stack, str(int(text) + int(data)), bss, same]


def _host_hash(source: Path, real: str) -> str:
    """The hash of export_cortex_m.c, of the same C compiled for this machine."""
    from necc_casadi.export.compiled import load_controller

    compiled, value = load_controller(source), 0
    number = np.float32 if real == "float" else np.float64
    for call in range(200):
        results = compiled.control([call / 64, number(0.1)], [number(0.2)])
        for bits in np.concatenate(results).astype(number).view(np.uint32):
            value = ((value ^ int(bits)) * 1099511628211) % 2**64
    return str(value)


# --- the table ------------------------------------------------------------------------------------


def report_compiled(times: dict[str, float]) -> None:
    """Times, ratios to the emitted code, and the figures measured elsewhere."""
    print("\n| variant | ns per call | measured elsewhere |\n|---|---|---|")
    for label, ns in times.items():
        print(f"| {label} | {ns:.0f} | {ELSEWHERE.get(label, '')} |")
    native, plain = times["d2 emitted, -O3 native"], times["d2 emitted, -O2"]
    generated = [ns for label, ns in times.items() if label.startswith("d2 CasADi")]
    at_o2 = min(times["d2 CasADi MX, -O2"], times["d2 CasADi SX, -O2"])
    bound = times["d2 hand-tuned bound"]
    exact = times["d2 emitted, -O3 native, no contraction"]
    print("\n| ratio, d2 double | goal | measured |\n|---|---|---|")
    print(f"| emitted -O3 native / hand-tuned bound | ≤ 1.1 | {native / bound:.2f} |")
    print(f"| the same without contraction: bits alike everywhere | | {exact / bound:.2f} |")
    print(
        f"| CasADi at its best flags / emitted -O3 native | ≥ 5 | {min(generated) / native:.1f} |"
    )
    print(f"| CasADi -O2 / emitted -O2 | ≥ 2 | {at_o2 / plain:.1f} |")
    for flags in ("-O3 native", "-O3 native, no contraction", "-O3 AVX2", "-O2"):
        if f"d2 emitted, {flags}" not in times:
            continue
        share = times[f"d2 emitted, float, {flags}"] / times[f"d2 emitted, {flags}"]
        print(f"| emitted float / double, {flags} | ≤ 0.65 | {share:.2f} |")


def report_peers(peers: dict[str, float], native: float) -> None:
    """Peers beside the C call."""
    print("\n| peer, d2, called from Python | µs | times emitted -O3 native |\n|---|---|---|")
    for name, us in sorted(peers.items(), key=lambda item: item[1]):
        print(f"| {name} | {us:.1f} | {1e3 * us / native:.0f} |")


def main() -> None:
    """Run everything that this machine has the tools for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=2000)
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--no-cortex", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(f"{platform.processor() or platform.machine()}, {platform.platform()}")
        times = time_compiled(folder, options.rounds)
        report_compiled(times)
        if not options.no_peers:
            report_peers(time_peers(folder), times["d2 emitted, -O3 native"])
        tools = [shutil.which(tool) for tool in ("arm-none-eabi-gcc", "qemu-system-arm")]
        if all(tools) and not options.no_cortex:
            print("\n| Cortex | instructions | stack, B | flash, B | .bss, B | same bits |")
            print("|---|---|---|---|---|---|")
            for name, level, core, real, cells in cortex(folder):
                print(f"| {name} {level}, {core}, {real} | {' | '.join(cells)} |")
            print(
                "goals, float: d2 ≤ 50000, d1 ≤ 8000 instructions, ≤ 30 KB, ≤ 1.5 KB stack, no .bss"
            )


if __name__ == "__main__":
    main()
