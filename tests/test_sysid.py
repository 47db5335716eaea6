"""Round trip with MuJoCo's system identification, on the arm of the examples."""

import numpy as np
import pytest
from model_rig import GRAVITY, Mapped, PlainModel, poses_and_moves, scenario_text

from tiltcal.core.assets import folder
from tiltcal.core.units import ARCSEC
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltsim.sysid import Exchange

ARM = folder("scenarios") / "arm" / "arm.xml"
AXES = {
    "pan": Mapped("pan"),
    "lift": Mapped("lift", -1, 0.2),
    "elbow": Mapped("elbow", 1, -0.1),
    "wrist": Mapped("wrist", -1),
}


def written(place, effects, site="tool"):
    (place / ARM.name).write_bytes(ARM.read_bytes())
    text = scenario_text(ARM, AXES, site)
    file = place / "scenario.toml"
    file.write_text(text + effects)
    return file


def recorded(poses=4, seed=1):
    time, jets = poses_and_moves(np.random.default_rng(seed), list(AXES), poses)
    columns = {f"table_{a}_rad": j[0] for a, j in jets.items()}
    columns |= {f"accelerometer_{a}_m_s2": np.zeros(len(time)) for a in "xyz"}
    return Recording.from_columns(time, columns), time, jets


def law(id, axis=None, **sizes):
    where = [f'axis = "{axis}"'] if axis else []
    lines = [f'id = "{id}"', *where, 'role = "found"', *(f"{k} = {v}" for k, v in sizes.items())]
    return "\n".join(["[[effect]]", *lines, ""])


LAWS = {
    "first joint of a body": law("joint_axis_tilt", "elbow", tilt_x_arcsec=400, tilt_y_arcsec=-300),
    "second joint of it": law("joint_axis_tilt", "wrist", tilt_x_arcsec=400, tilt_y_arcsec=-300),
    "zero": law("table_encoder_zero", lift_zero_arcsec=500, wrist_zero_arcsec=-700),
    "eccentricity": law("table_encoder_eccentricity", "lift", cos_arcsec=300, sin_arcsec=200),
    "levelling": law("table_levelling", tilt_east_arcsec=500, tilt_north_arcsec=-300),
    "mounting": law("mount_misalignment", tilt_x_arcsec=500, tilt_z_arcsec=-300),
    "lever arm": law("lever_arm", lever_x_mm=20, lever_z_mm=-30),
    "gravity": law("gravity_magnitude", gravity_error_ppm=300),
    "joint bends": law(
        "joint_compliance",
        "wrist",
        bend_x_arcsec_N_m=3,
        bend_y_arcsec_N_m=2,
        bend_z_arcsec_N_m=4,
    ),
    "base bends": law("base_load_compliance", bend_east_arcsec_N_m=0.4, bend_north_arcsec_N_m=0.6),
}


@pytest.mark.parametrize("name", LAWS)
def test_the_users_own_model_moves_as_the_closed_form_says(tmp_path, name):
    exchange = Exchange.of(written(tmp_path, LAWS[name]), ARM)
    recording, time, _ = recorded()
    course = replay(recording, exchange.scenario)
    effects = exchange.effects(exchange.parameters)
    times = {"accelerometer": time}
    closed = readings(exchange.scenario, course, times, effects)["accelerometer"]
    own = readings(exchange.scenario, course, times, effects, mover=exchange._move)["accelerometer"]
    without = readings(exchange.scenario, course, times, ())["accelerometer"]
    print(name, np.abs(own - closed).max(), np.abs(closed - without).max())
    assert np.abs(own - closed).max() < 1e-2 * np.abs(closed - without).max()
