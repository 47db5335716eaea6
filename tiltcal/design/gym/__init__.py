"""Gymnasium environments of the design problem: pick poses under a table time, be paid in nats.

``import tiltcal.design.gym`` registers ``tiltcal/Calibration-v0`` (continuous) and
``tiltcal/CalibrationDiscrete-v0``; so does
``gymnasium.make("tiltcal.design.gym:tiltcal/Calibration-v0")``. ``make_vec`` gets the native
vectorised ones.
"""

import gymnasium

IDS = {
    "tiltcal/Calibration-v0": "Calibration",
    "tiltcal/CalibrationDiscrete-v0": "CalibrationDiscrete",
}


def register_envs() -> None:
    """Register the environments; twice does no harm."""
    for id, name in IDS.items():
        if id not in gymnasium.registry:
            gymnasium.register(
                id,
                entry_point=f"tiltcal.design.gym.environment:{name}",
                vector_entry_point=f"tiltcal.design.gym.vector:{name}Vector",
            )


register_envs()
