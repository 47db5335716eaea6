"""A gimbal with four axes."""

from pathlib import Path

from tiltcal.setup.tables import Table

GIMBAL = Table(
    "gimbal",
    (("azimuth", "z"), ("elevation", "x"), ("roll", "y"), ("spin", "z")),
    model=Path(__file__).with_name("gimbal.xml"),
)
