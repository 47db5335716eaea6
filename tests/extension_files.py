"""The files that the tests of the extension package are run on; its guide pages show them."""

HEAD = """\
schema = 1
name = "a gimbal with three-lobed bearings"
seed = 5
[site]
gravity_m_s2 = 9.80123
latitude_deg = 39.9
[rig]
table = "gimbal"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 20
adjustable = ["bias", "scale", "cross_axis"]
[[effect]]
id = "acc_noise"
white_ug_rthz = 20
"""
CONCEALED = """\
[[effect]]
id = "table_wobble_third"
axis = "roll"
cos_arcsec = 40
sin_arcsec = -25
"""
FACES = """\
[[effect]]
id = "acc_bias"
bias_x_ug = 3000
bias_y_ug = -2000
[[effect]]
id = "acc_scale"
scale_z_ppm = 1500
[[sequence]]
action = "scheme"
scheme = "6"
dwell_s = 6
[[method]]
name = "opposite_faces"
runs = 3
[method.accept]
required = ["accel.bias", "accel.scale"]
"""


def tumble() -> str:
    """48 poses all over the sphere, the innermost axis elsewhere in each."""
    poses = [(e, r + 15) for e in range(-180, 180, 45) for r in range(0, 360, 60)]
    step = '[[sequence]]\naction = "move"\nrate_deg_s = 60\ndwell_s = 3\n'
    return "".join(
        f"{step}elevation_deg = {e}\nroll_deg = {r}\nspin_deg = {37 * k % 360 - 180}\n"
        for k, (e, r) in enumerate(poses)
    )
