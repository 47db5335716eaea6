"""The links of a user's own model as MJCF with the frames that effects turn: like the tables of
``models/``.
"""

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from tiltcal.setup.chain import BASE, Chain, Link, Place
from tiltcal.setup.tables import bearing

LIGHT = 1e-4  # kg, and ten times the kg m2, of frames that only hold others
SMALLEST = 1e-6  # kg and kg m2: MuJoCo refuses a body that moves and has none


def mjcf_of(chain: Chain) -> str:
    """MJCF of the links: a body ``<axis>`` with a hinge or slide of that name behind a frame
    ``<axis>_bearing``, and the instrument behind ``mount``.
    """
    root = Element("mujoco", model="links")
    SubElement(root, "compiler", angle="radian", autolimits="true")
    SubElement(root, "option", gravity="0 0 -9.80665", timestep="0.0005", integrator="implicitfast")
    defaults = SubElement(root, "default")
    SubElement(defaults, "geom", contype="0", conaffinity="0", mass="0", group="1")
    SubElement(defaults, "site", group="2")
    base = _body(_body(SubElement(root, "worldbody"), "pier", 200.0), "base", 80.0)
    bodies = {BASE: base}
    for link in chain.link:
        bodies[link.axis] = _link(bodies[link.on], link)
    _instrument(bodies[chain.instrument.on], chain.instrument)
    servos = SubElement(root, "actuator")
    for link in chain.link:
        if not link.servo_N_m_rad:
            continue
        servo = SubElement(servos, "position", name=link.axis, joint=link.axis)
        servo.set("kp", repr(link.servo_N_m_rad))
        servo.set("kv", repr(link.servo_N_m_s_rad))
    sensors = SubElement(root, "sensor")
    SubElement(sensors, "accelerometer", name="accel", site="accel")
    for name in ("gyro", "fog"):
        SubElement(sensors, "gyro", name=name, site=name)
    return ElementTree.tostring(root, encoding="unicode")


def _link(parent: Element, link: Link) -> Element:
    """A link on its parent: its place, its bearing, and what moves."""
    place = _body(parent, f"{link.axis}_place", SMALLEST, link)
    body = SubElement(_body(place, bearing(link.axis), SMALLEST), "body", name=link.axis)
    kind = "slide" if link.slides else "hinge"
    joint = SubElement(body, "joint", name=link.axis, type=kind, axis="0 0 1")
    joint.set("armature", repr(link.armature_kg_m2))
    joint.set("damping", repr(link.damping_N_m_s_rad))
    joint.set("frictionloss", repr(link.friction_N_m))
    inertial = SubElement(body, "inertial", pos=_numbers(link.centre_m))
    inertial.set("mass", repr(max(link.mass_kg, SMALLEST)))
    moments = [i + SMALLEST for i in link.inertia_kg_m2[:3]]
    inertial.set("fullinertia", _numbers([*moments, *link.inertia_kg_m2[3:]]))
    return body


def _instrument(parent: Element, place: Place) -> None:
    """The mount behind the instrument's place, with the hinges of its compliance."""
    inner = _body(_body(parent, "instrument_place", LIGHT, place), "mount", LIGHT)
    for axis, along in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True):
        name = f"bend_{axis}"
        inner = _body(inner, name, LIGHT)
        SubElement(inner, "joint", name=name, axis=along, stiffness="2000", damping=".4")
    SubElement(inner, "include", file="instrument.xml")


def _body(parent: Element, name: str, mass: float, place: Place | None = None) -> Element:
    """A body that only holds others, where a place says."""
    body = SubElement(parent, "body", name=name)
    if place is not None:
        body.set("pos", _numbers(place.offset_m))
        body.set("quat", _numbers(place.rotation))
    inertia = _numbers([mass * 0.1] * 3)
    SubElement(body, "inertial", pos="0 0 0", mass=repr(mass), diaginertia=inertia)
    return body


def _numbers(values: "tuple[float, ...] | list[float]") -> str:
    return " ".join(map(repr, values))
