"""Gymnasium environments: the design problem, and the rig of any scenario.

``import tiltcal.design.gym`` registers ``tiltcal/Calibration-v0`` (continuous) and
``tiltcal/CalibrationDiscrete-v0``, in which poses are picked under a table time and paid in nats,
and ``tiltcal/Rig-v0``, which turns the axes of a scenario's rig and reads its instrument; so does
``gymnasium.make("tiltcal.design.gym:tiltcal/Calibration-v0")``. ``make_vec`` gets the native
vectorised ones.
"""

import gymnasium

IDS = {
    "tiltcal/Calibration-v0": "Calibration",
    "tiltcal/CalibrationDiscrete-v0": "CalibrationDiscrete",
}
RIG = "tiltcal/Rig-v0"


def register_envs() -> None:
    """Register the environments; twice does no harm."""
    positions = {
        id: (f"environment:{name}", f"environment:{name}Vector") for id, name in IDS.items()
    } | {RIG: ("rig_environment:RigEnvironment", "rig_environment:RigEnvironmentVector")}
    for id, (single, many) in positions.items():
        if id not in gymnasium.registry:
            gymnasium.register(
                id,
                entry_point=f"tiltcal.design.gym.{single}",
                vector_entry_point=f"tiltcal.design.gym.{many}",
            )


register_envs()
