"""Estimators fed sample by sample: built in, the user's own, and firmware as a process; judged
against the truth.
"""

import sys

import host
import numpy as np
import pytest
from builders import ACCEL, GYRO, G, setup_of
from scenario_files import HEAD

from tiltcal.api.simulating import simulator
from tiltcal.calibration.firmware.header import header
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import rotation
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.laboratory.scenario_tables import EstimatorTable
from tiltcal.validation.acceptance import run_scenario
from tiltcal.validation.online import judging
from tiltcal.validation.online.estimators import make_estimator
from tiltcal.validation.online.judging import OnlineResult, Process, feed, part_of, run_estimator

SWEEP = [{"action": "rest", "dwell_s": 2}] + [
    {"action": "sweep", "outer_deg": a, "step_deg": 10, "dwell_s": 1.5, "rate_deg_s": 60}
    for a in (90, 0)
]
BIAS = {"cos1_x_ug": 900, "cos2_y_ug": 700, "sin1_y_ug": 800}
LIVE = [{"action": "remount", "mount": "Rz(45)", "dwell_s": 3}] + [
    {"action": "move", "outer_deg": a, "dwell_s": 3, "rate_deg_s": 60} for a in (13, 27, 41, 8)
]
PLACING = {
    "schema": 1,
    "name": "on line",
    "site": {"gravity_m_s2": G},
    "rig": {"table": "placing"},
    "sensor": [{"name": "accel", "kind": "accelerometer", "axes": ["x", "y"], "rate_hz": 50.0}],
    "effect": [{"id": "acc_noise", "white_ug_rthz": 2}, {"id": "acc_angle_bias", **BIAS}],
    "sequence": [*SWEEP, {"action": "remount", "mount": "Rz(90)", "dwell_s": 2}, *SWEEP[1:], *LIVE],
}
SETUP = setup_of(
    "dual", ACCEL.model_copy(update={"rate_hz": 100.0}), GYRO.model_copy(update={"rate_hz": 100.0})
)


@pytest.fixture(scope="module")
def live():
    """The scenario, its recording, and where the live part begins, s."""
    scenario = parse_scenario(PLACING)
    start = next(leg.t0 for leg in scenario.schedule.legs if leg.mount == "Rz(45)")
    return scenario, simulator().record(scenario, 1), start


def run(live, **table) -> OnlineResult:
    scenario, recording, start = live
    case = scenario.model_copy(update={"seed": 1})
    return run_estimator(case, EstimatorTable(from_s=start, **table), recording, simulator())


def test_the_corrector_takes_both_biases_off_on_line(live):
    plain = run(live, name="accelerometer")
    fed = run(live, name="placing", calibrate="placing_table")
    assert fed.answered == 1
    assert plain.rms() / ARCSEC > 100
    # noise of 14 ug a sample and axis, and 10 deg steps of the table: h^2/8 max|b''| = 11 ug at 0.7
    # mg cos 2 beta
    assert fed.rms() / ARCSEC < 9
    assert fed.rms("rest") == pytest.approx(fed.rms("move"), rel=0.5)


def test_an_inclinometer_is_fed_as_well_and_corrected_alike(live):
    """The same errors act on its force before the arcsine: two recordings without noise give the
    same tilts.
    """
    scenario, _, start = live
    level = PLACING["sensor"][0] | {"kind": "inclinometer"}
    twin = parse_scenario(PLACING | {"sensor": [level]})
    quiet = simulator().record(twin, None)
    for table in ({"name": "accelerometer"}, {"name": "placing", "calibrate": "placing_table"}):
        one, other = (
            run_estimator(
                s.model_copy(update={"seed": None}),
                EstimatorTable(from_s=start, **table),
                r,
                simulator(),
            )
            for s, r in ((scenario, simulator().record(scenario, None)), (twin, quiet))
        )
        np.testing.assert_allclose(other.error, one.error, atol=1e-9)
    assert other.rms() / ARCSEC < 9


@pytest.mark.skipif(
    host.compiler() is None, reason="no C compiler on this machine: cc, gcc or clang"
)
def test_the_exported_c_runs_as_a_process_and_errs_as_the_corrector_does(live, tmp_path):
    scenario, recording, start = live
    found = calibrate("placing_table", part_of(recording, recording.time < start), scenario)
    (tmp_path / "level.h").write_text(header(found, scenario, "level"))
    program = host.build(tmp_path / "level.h", "-DLEVEL_DOUBLE")
    firmware = run(live, command=(str(program),))
    python = run(live, name="placing", calibrate="placing_table")
    np.testing.assert_allclose(firmware.error, python.error, atol=1e-12)
    case = parse_scenario(
        PLACING
        | {"estimator": [{"command": [str(program)], "from_s": start, "accept": {"rms_arcsec": 9}}]}
    )
    with pytest.raises(
        TiltcalError, match=r"need permission to run programs; read it, then add --allow-commands"
    ):
        run_scenario(case, simulator())
    result = run_scenario(case, simulator(), allow_commands=True)
    assert result.accepted
    assert "samples answered" in [limit.name for limit in result.methods[0].limits]


def swung(error) -> OnlineResult:
    """Errors (rad) of a recording with a rest, a move of 2 s and a rest, judged."""
    from tiltcal.validation.online.judging import judge

    scenario = parse_scenario(
        PLACING
        | {
            "sequence": [
                {"action": "rest", "dwell_s": 5},
                {"action": "move", "outer_deg": 32, "dwell_s": 5},
            ]
        }
    )
    legs = scenario.schedule.legs
    time = np.arange(0, legs[-1].t1, 0.01)
    e = error(time, legs[1].t0, legs[1].t1)
    return judge(
        time, np.column_stack([0 * e, e]), np.tile([0.0, 0.0, 1.0], (len(time), 1)), scenario, 1e-6
    )


def test_errors_are_split_by_rest_and_motion_and_settling_is_timed():
    fading = swung(
        lambda t, start, end: np.where(
            t < start, 1e-4, np.where(t < end, 1e-2, 1e-2 * np.exp(-(t - end)))
        )
    )
    assert [s.kind for s in fading.sections] == ["rest", "move", "rest"]
    assert fading.rms("move") == pytest.approx(1e-2, rel=1e-6)
    assert fading.sections[0].rms == pytest.approx(1e-4, rel=1e-6)
    assert fading.worst == pytest.approx(1e-2, rel=1e-6)
    assert fading.settling(1e-3) == pytest.approx(np.log(10), abs=0.02)
    assert fading.settling(2e-2) == 0.0
    accept = EstimatorTable(name="a", accept={"settled_arcsec": 200, "settling_s": 2.4}).accept
    limits = {name: ok for name, _, _, ok in fading.limits(accept)}
    assert limits == {"samples answered": True, "settling to 200 arcsec, s": True}


def test_samples_without_an_answer_are_counted_and_never_taken_for_good():
    gaps = swung(lambda t, *_: np.where(t < 1.0, np.nan, 1e-4))
    assert gaps.answered == pytest.approx(1 - 1 / gaps.time[-1], abs=0.01)
    assert not next(iter(gaps.limits(EstimatorTable(name="a").accept)))[3]
    nothing = swung(lambda t, *_: np.nan * t)
    assert np.isnan([nothing.rms(), nothing.worst]).all()
    rms = list(nothing.limits(EstimatorTable(name="a", accept={"rms_arcsec": 1e9}).accept))[1]
    assert not rms[3]


def still(bias=(0.0, 0.0, 0.0), seconds=60.0, tilt=0.1):
    """Samples at rest at a roll, with a gyro bias, rad/s; the roll is the elevation of y."""
    f = tuple(rotation("x", tilt).T @ [0, 0, G])
    return [{"time_s": k / 100, "accel": f, "gyro": bias} for k in range(int(seconds * 100))]


def test_a_complementary_filter_leaves_bias_times_its_time_constant():
    filter_ = make_estimator("complementary", SETUP, None, {"tau_s": 2.0})
    tilt, _ = feed(filter_, [still(bias=(1e-3, 0.0, 0.0))], "complementary")
    assert tilt[0, 1] == pytest.approx(0.1, abs=1e-9)
    assert tilt[-1, 1] - 0.1 == pytest.approx(2e-3, rel=0.01)  # b tau


def test_a_kalman_filter_learns_the_bias():
    filter_ = make_estimator("kalman", SETUP, None, {"accel_sigma": 0.01})
    tilt, _ = feed(filter_, [still(bias=(1e-3, 0.0, 0.0), seconds=200)], "kalman")
    assert abs(tilt[-1, 1] - 0.1) < 1e-5
    assert filter_.filter.x[3, 0] == pytest.approx(1e-3, rel=0.01)


@pytest.mark.parametrize("name", ["complementary", "kalman"])
def test_a_filter_carries_a_turn_by_its_gyro(name):
    filter_ = make_estimator(name, SETUP, None, {})
    samples = [{"time_s": k / 1000, "gyro": (0.5, 0.0, 0.0)} for k in range(1001)]
    samples[0]["accel"] = (0.0, 0.0, G)  # and never again
    tilt, _ = feed(filter_, [samples], name)
    assert tilt[-1] == pytest.approx([0.0, 0.5], abs=1e-3)  # Rx(+a) lifts y


def test_a_sample_of_one_sensor_alone_is_enough_for_a_filter():
    for name in ("complementary", "kalman"):
        filter_ = make_estimator(name, SETUP, None, {})
        first, last = (
            {"time_s": 0.0, "gyro": (0.0, 0.0, 0.0)},
            {"time_s": 0.2, "gyro": (0.1, 0.0, 0.0)},
        )
        tilt, _ = feed(filter_, [[first, {"time_s": 0.1, "accel": (0.0, 0.0, G)}, last]], name)
        assert np.isnan(tilt[0]).all()
        assert tilt[2, 1] == pytest.approx(0.01, abs=1e-4)


MODULE = """
class Own:
    def __init__(self, gain):
        self.gain = gain
    def update(self, sample):
        if self.gain < 0:
            raise ValueError("gain below zero")
        return (0.0,) if self.gain == 0 else (0.0, self.gain)


def own(setup, *, gain=1.0):
    return Own(gain)


def nothing(setup):
    return object()
"""


@pytest.fixture
def module(here, monkeypatch):
    (here / "lab_estimators.py").write_text(MODULE)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield "lab_estimators"
    sys.modules.pop("lab_estimators", None)


def test_an_estimator_of_the_user_s_is_judged_from_the_command_line(module, here, capsys):
    text = (
        HEAD
        + '[[sequence]]\naction = "move"\nouter_deg = 10\ndwell_s = 3\n'
        + f'[[estimator]]\nname = "{module}:own"\n'
    )
    (here / "own.toml").write_text(
        text + "options = { gain = 0.17453292519943295 }\n[estimator.accept]\nrest_arcsec = 1\n"
    )
    assert main(["run", "own.toml", "-o", "out"]) == 0
    out = capsys.readouterr().out
    assert "on line" in out
    assert "us a sample" in out
    assert "tilt error at rest" in (here / "out" / "junit.xml").read_text()
    assert "us a sample" in (here / "out" / "report.html").read_text()
    (here / "own.toml").write_text(text + "[estimator.accept]\nrest_arcsec = 1\n")
    assert main(["run", "own.toml", "--json"]) == 1


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("{}:own", {"gian": 1}, "found option 'gian', need an option of it; did you mean 'gain'"),
        ("{}:nothing", {}, "found a object, need an object with update"),
        ("kalmn", {}, "did you mean 'kalman'"),
        ("{}:missing", {}, "has no attribute 'missing'"),
        ("placing", {}, "estimator placing: found no calibration"),
    ],
)
def test_an_estimator_that_does_not_keep_to_the_contract_is_told_so(module, name, options, message):
    with pytest.raises(TiltcalError, match=message):
        make_estimator(name.format(module), SETUP, None, options)


def test_failures_while_it_runs_are_said_to_be_its_own(module):
    with pytest.raises(
        TiltcalError, match=r"sample 1: found an error in it \(ValueError: gain below zero\)"
    ):
        feed(make_estimator(f"{module}:own", SETUP, None, {"gain": -1}), [still(seconds=1)], "own")
    with pytest.raises(TiltcalError, match=r"answers of shape \(1,\), need two numbers"):
        feed(make_estimator(f"{module}:own", SETUP, None, {"gain": 0}), [still(seconds=1)], "own")
    with pytest.raises(
        TiltcalError, match="found no such sensor in the scenario, need a sensor of kind gyro"
    ):
        make_estimator("kalman", setup_of("dual", ACCEL), None, {})


def test_what_cannot_be_judged_is_refused_in_words(live):
    scenario, recording, _ = live
    with pytest.raises(TiltcalError, match="beyond the recording"):
        run_estimator(
            scenario, EstimatorTable(name="accelerometer", from_s=1e6), recording, simulator()
        )
    with pytest.raises(TiltcalError, match="no sample before from_s"):
        run_estimator(
            scenario,
            EstimatorTable(name="placing", calibrate="placing_table"),
            recording,
            simulator(),
        )
    with pytest.raises(TiltcalError, match="found a laboratory without truth"):
        run_estimator(scenario, EstimatorTable(name="accelerometer"), recording, object())
    bare = Calibration("x", "good", {}, np.zeros((0, 0)))
    with pytest.raises(TiltcalError, match="without placing-angle tables"):
        make_estimator("placing", scenario, bare, {})
    for wrong in (
        {},
        {"name": "a", "command": ["b"]},
        {"command": ["b"], "calibrate": "placing_table"},
    ):
        with pytest.raises(TiltcalError, match=r"estimator.1"):
            parse_scenario(PLACING | {"estimator": [wrong]})


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("print('nonsense', flush=True); input(); input()", "the answer 'nonsense'"),
        ("pass", "a program that has ended"),
        ("import time; time.sleep(30)", "no answer within 0.3 s"),
        ("print('1,2,3', flush=True); input(); input()", "the answer '1,2,3'"),
    ],
)
def test_a_program_that_does_not_answer_rightly_is_told_so(code, message, monkeypatch):
    monkeypatch.setattr(judging, "PATIENCE", 0.3 if "sleep" in code else 10.0)
    program = Process([sys.executable, "-c", code], SETUP)
    with pytest.raises(TiltcalError, match=message):
        feed(program, [still(seconds=1)], "program")
    assert program.process.poll() is not None


def test_a_program_that_is_not_there_is_named():
    with pytest.raises(TiltcalError, match=r"command ./no-such: .*need a program that runs"):
        Process(["./no-such"], SETUP)


def test_a_program_gets_a_line_a_sample_with_empty_cells_where_nothing_was_sampled():
    code = (
        "import sys\nfor line in sys.stdin: print(line.count(','), line.split(',').index(''),"
        " sep=',', flush=True)"
    )
    program = Process([sys.executable, "-c", code], SETUP)
    try:
        assert program.update({"time_s": 0.5, "accel": (1.0, 2.0, 3.0)}) == (6.0, 4.0)
    finally:
        program.close()


def test_the_truth_of_a_run_by_time_steps_is_the_mechanics_own():
    text = PLACING | {
        "sequence": [{"action": "move", "outer_deg": 20, "dwell_s": 1}],
        "dynamics": {"stiffness_N_m_rad": 2000.0},
    }
    scenario = parse_scenario(text)
    time = np.arange(0, 1.2, 0.1)
    true, asked = (
        simulator().true_up(scenario, 1, time),
        simulator().true_up(parse_scenario(text | {"dynamics": None}), 1, time),
    )
    lag = np.degrees(np.linalg.norm(true - asked, axis=1)).max()
    assert lag > 0.01  # the servo follows late: prescribed motion would not be the truth
