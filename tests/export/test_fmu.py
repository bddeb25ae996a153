"""The FMI 2.0 unit against Python, driven by a minimal master and by FMPy where it is installed."""

import ctypes
import importlib.util
import subprocess
import zipfile
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import of_small_level
from helpers.export_cases import COMPILERS, STRICT, design, pendulum_loop
from helpers.velocity import pendulum as sprung_pendulum
from helpers.velocity import pendulum_with_load

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.export.fmu import export_fmu
from necc_casadi.export.source import Source
from necc_casadi.export.vectors import next_state, reference_step
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.synthesis.integral import with_integral

FMPY = importlib.util.find_spec("fmpy") is not None
STEPS, DT = 200, 0.01


def example():
    form = Form(Network(1, (8,), quadratic=True), Network(1, (8,), quadratic=True))
    return design(pendulum_loop(((-1.5, 1.5),)), form, 0)


def measured(k):
    """The plant state that the controller is shown at step k."""
    return np.array([0.5 + 0.6 * np.sin(0.05 * k), 0.4 * np.cos(0.08 * k)])


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    d = example()
    path = export_fmu(d, tmp_path_factory.mktemp("fmu") / "pendulum-held.fmu", sample_time=DT)
    folder = path.parent / "unpacked"
    zipfile.ZipFile(path).extractall(folder)
    return d, path, folder


class Callbacks(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in ("log", "new", "free", "done", "env"))


class Master:
    """Instantiates, sets, steps and gets: the calls that every FMI 2.0 master makes."""

    def __init__(self, folder, guid):
        self.dll = ctypes.CDLL(str(folder / "binaries" / "linux64" / "pendulum_held.so"))
        libc = ctypes.CDLL(None)
        new, free = (ctypes.cast(f, ctypes.c_void_p).value for f in (libc.calloc, libc.free))
        self.callbacks = Callbacks(None, new, free, None, None)
        self.dll.fmi2Instantiate.restype = ctypes.c_void_p
        pointer = ctypes.byref(self.callbacks)
        made = self.dll.fmi2Instantiate(b"held", 1, guid.encode(), None, pointer, 0, 0)
        self.component = ctypes.c_void_p(made)

    def call(self, name, *arguments):
        return getattr(self.dll, name)(self.component, *arguments)

    def set(self, x):
        references, values = (ctypes.c_uint * 2)(0, 1), (ctypes.c_double * 2)(*x)
        assert self.call("fmi2SetReal", references, ctypes.c_size_t(2), values) == 0

    def get(self):
        references, values = (ctypes.c_uint * 2)(2, 3), (ctypes.c_double * 2)()
        assert self.call("fmi2GetReal", references, ctypes.c_size_t(2), values) == 0
        return list(values)

    def flags(self):
        references, values = (ctypes.c_uint * 1)(0), (ctypes.c_int * 1)()
        assert self.call("fmi2GetInteger", references, ctypes.c_size_t(1), values) == 0
        return values[0]

    def step(self, time, h):
        return self.call("fmi2DoStep", ctypes.c_double(time), ctypes.c_double(h), 1)


def description(folder):
    return ET.parse(folder / "modelDescription.xml").getroot()


def start(unit, x0):
    _, _, folder = unit
    master = Master(folder, description(folder).get("guid"))
    assert master.component.value is not None
    master.set(x0)
    assert master.call("fmi2EnterInitializationMode") == 0
    assert master.call("fmi2ExitInitializationMode") == 0
    return master


def test_steps_are_those_of_python(unit):
    d = unit[0]
    master, step = start(unit, measured(0)), reference_step(d, "heun")
    xi = np.array(master.get()[1:])
    np.testing.assert_allclose(xi, d.xi_at_start(measured(0)), rtol=0, atol=1e-12)
    for k in range(STEPS):
        x = measured(k)
        master.set(x)
        u, after = (np.asarray(v, float).ravel() for v in step(x, xi, DT))
        np.testing.assert_allclose(master.get(), [*np.clip(u, -1.5, 1.5), *xi], rtol=0, atol=1e-12)
        assert master.step(k * DT, DT) == 0
        assert master.flags() == int(abs(u[0]) > 1.5)
        xi = after
    master.call("fmi2FreeInstance")


def test_casimirs_are_kept_in_a_unit(tmp_path):
    """ξ is that of the x that is shown, before the step is made."""
    d, options = example(), {"integrator": "casimir", "sample_time": DT}
    path = export_fmu(d, tmp_path / "pendulum-held.fmu", **options)
    zipfile.ZipFile(path).extractall(tmp_path / "unpacked")
    master = start((d, path, tmp_path / "unpacked"), measured(0))
    after, xi = next_state(Source(d, **options)), np.array(master.get()[1:])
    for k in range(STEPS):
        master.set(measured(k))
        xi = after(measured(k - 1), xi, DT, measured(k)) if k else xi
        u = np.clip(d.control(measured(k), xi)[0], -1.5, 1.5)
        np.testing.assert_allclose(master.get(), [*u, *xi], rtol=0, atol=1e-12)
        assert master.step(k * DT, DT) == 0
    master.call("fmi2FreeInstance")


def test_a_saved_state_comes_back_and_bad_input_is_a_warning(unit):
    master = start(unit, measured(3))
    saved = ctypes.c_void_p(None)
    before = master.get()
    assert master.call("fmi2GetFMUstate", ctypes.byref(saved)) == 0
    master.step(0.0, 0.5)
    assert master.get() != before
    assert master.call("fmi2SetFMUstate", saved) == 0
    assert master.get() == before
    assert master.call("fmi2FreeFMUstate", ctypes.byref(saved)) == 0
    assert saved.value is None
    master.set([np.nan, 0])
    assert master.step(0.0, 0.5) == 1
    assert (master.flags(), master.get()) == (2, [0, before[1]])
    assert master.call("fmi2Reset") == 0
    master.call("fmi2FreeInstance")


def test_another_guid_is_refused(unit):
    assert Master(unit[2], "{another}").component.value is None


def test_description_lists_the_variables_in_the_order_of_the_code(unit):
    d, _, folder = unit
    root = description(folder)
    names = [v.get("name") for v in root.iter("ScalarVariable")]
    assert names == ["q", "p", "u1", "xi1", "flags", "start_at_minimum"]
    assert d.hash[:32] in root.get("guid")
    assert [u.get("name") for u in root.iter("Unit")] == ["rad", "kg m²/s"]


def test_the_archive_is_the_same_every_time(tmp_path):
    d = example()
    first, second = (export_fmu(d, tmp_path / n / "a.fmu").read_bytes() for n in "ab")
    assert first == second


@pytest.mark.parametrize("compiler", COMPILERS)
def test_the_wrapper_compiles_without_a_warning(unit, compiler):
    source = unit[2] / "sources" / "fmu.c"
    subprocess.run([compiler, *STRICT, "-c", str(source), "-o", "/dev/null"], check=True)


if FMPY:

    @pytest.mark.filterwarnings("ignore::DeprecationWarning")
    def test_fmpy_validates_and_simulates(unit):
        from fmpy import simulate_fmu
        from fmpy.validation import validate_fmu

        d, archive, _ = unit
        assert validate_fmu(str(archive)) == []
        signal = np.array(
            [(k * DT, *measured(k)) for k in range(STEPS + 1)],
            dtype=[("time", float), ("q", float), ("p", float)],
        )
        result = simulate_fmu(
            str(archive), stop_time=STEPS * DT, step_size=DT, output_interval=DT, input=signal,
            start_values={"q": measured(0)[0], "p": measured(0)[1]},
        )  # fmt: skip
        assert len(result) == STEPS + 1
        step, xi = reference_step(d, "heun"), result["xi1"][:1]
        for k in range(STEPS):
            u, after = (np.asarray(v, float).ravel() for v in step(measured(k), xi, DT))
            xi = after
            u = np.clip(d.control(measured(k), xi)[0], -1.5, 1.5)
            assert abs(result["xi1"][k + 1] - xi[0]) <= 1e-12
            assert abs(result["u1"][k + 1] - u[0]) <= 1e-12


def unpacked(made, folder, certificate=None):
    """A unit that is called pendulum_held, and its master."""
    path = export_fmu(made, folder / "pendulum_held.fmu", certificate=certificate)
    zipfile.ZipFile(path).extractall(folder / "unpacked")
    root = ET.parse(folder / "unpacked" / "modelDescription.xml").getroot()
    master = Master(folder / "unpacked", root.get("guid"))
    names = [v.get("name") for v in root.find("ModelVariables")]
    outputs = [int(u.get("index")) for u in root.find("ModelStructure/Outputs")]
    causes = [v.get("causality") for v in root.find("ModelVariables")]
    assert outputs == [i + 1 for i, cause in enumerate(causes) if cause == "output"]
    return master, names


def reals(master, name, references, values=None):
    array = (ctypes.c_double * len(references))(*(values or [0.0] * len(references)))
    chosen = (ctypes.c_uint * len(references))(*references)
    assert master.call(name, chosen, ctypes.c_size_t(len(references)), array) == 0
    return list(array)


def test_integral_action_and_velocities_in_the_unit(tmp_path):
    made = with_integral(sprung_pendulum())
    master, names = unpacked(made, tmp_path)
    assert names[:5] == ["q", "q_dot", "u1", "xi1", "zeta1"]
    reals(master, "fmi2SetReal", [0, 1], [0.5, 0.2])
    master.call("fmi2ExitInitializationMode")
    _, rate = made.measured_controller.call([[0.5, 0.2], [*made.xi_star, 0.0]])
    master.call("fmi2DoStep", ctypes.c_double(0), ctypes.c_double(0.01), 0)
    assert reals(master, "fmi2GetReal", [4])[0] == pytest.approx(0.01 * float(rate[1]))


def test_a_set_point_is_an_input_of_the_unit(tmp_path):
    made = replace(sprung_pendulum(), setpoints={"q": (sp.Integer(-2), sp.Integer(2))})
    master, names = unpacked(made, tmp_path, certify(made))
    at = names.index("target_q")
    assert reals(master, "fmi2GetReal", [at]) == [0.75]
    reals(master, "fmi2SetReal", [0, 1, at], [1.0, 0.0, 1.0])
    master.call("fmi2DoStep", ctypes.c_double(0), ctypes.c_double(0.01), 0)
    u = reals(master, "fmi2GetReal", [2])[0]
    assert u == pytest.approx(np.sin(1.0), abs=1e-9)  # what holds it at 1


def test_parameters_and_targets_are_taken_with_a_sample(tmp_path):
    """The weight that is told is held at once; u stays where the unit is asked to move ξ."""
    told = pendulum_with_load(l=(sp.Integer(0), sp.Rational(1, 2)))
    made = replace(sprung_pendulum(), setpoints={"q": (sp.Integer(-2), sp.Integer(2))}, told=told)
    master, names = unpacked(made, tmp_path, of_small_level(made))
    at, load, margin = (names.index(name) for name in ("target_q", "l", "margin"))
    reals(master, "fmi2SetReal", [0, 1], [0.75, 0.0])
    assert reals(master, "fmi2GetReal", [2, margin, load]) == pytest.approx([np.sin(0.75), 1, 0])
    reals(master, "fmi2SetReal", [load], [0.25])
    assert reals(master, "fmi2GetReal", [2])[0] == pytest.approx(1.25 * np.sin(0.75), abs=1e-9)
    master.step(0.0, 0.01)
    assert master.flags() == 0
    reals(master, "fmi2SetReal", [at, load], [0.8, 0.25])
    master.step(0.01, 0.01)
    before = reals(master, "fmi2GetReal", [2])[0]
    chosen, kind = (ctypes.c_uint * 1)(1), (ctypes.c_int * 1)(1)
    assert master.call("fmi2SetInteger", chosen, ctypes.c_size_t(1), kind) == 0
    reals(master, "fmi2SetReal", [at], [0.7])
    master.step(0.02, 0.0)
    assert reals(master, "fmi2GetReal", [2])[0] == pytest.approx(before, abs=1e-3)
    force = 1.25 * (np.sin(0.8) - np.sin(0.7))
    assert abs(force) > 0.05  # by which it jumps where ξ is kept
    reals(master, "fmi2SetReal", [load], [0.75])
    master.step(0.02, 0.01)
    assert master.flags() == 8
