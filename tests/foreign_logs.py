"""Logs as other systems write them: one motion in many dialects, units, frames and clocks, with
what a mapping of each ought to say.
"""

import itertools
import tomllib
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np
from scipy.spatial.transform import Rotation

G = 9.8072
START = datetime(2026, 5, 4, 12, 30, tzinfo=UTC)
MARKS = {"comma": ",", "semicolon": ";", "tab": "\t", "pipe": "|", "space": "  "}
FORCE = {"m_s2": 1.0, "g": 1 / 9.80665, "mg": 1000 / 9.80665, "LSB": 2048 / 9.80665}
RATE = {"rad_s": 1.0, "deg_s": 180 / np.pi, "LSB": 16.4 * 180 / np.pi}
HEADERS = {
    "short": ("t", "ax", "ay", "az", "gx", "gy", "gz"),
    "long": ("timestamp", "Acc_X", "Acc_Y", "Acc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z"),
    "dotted": ("time", "imu.acc.x", "imu.acc.y", "imu.acc.z", "imu.gyro.x", "imu.gyro.y",
               "imu.gyro.z"),
    "chinese": ("时间", "加速度X", "加速度Y", "加速度Z", "角速度X", "角速度Y", "角速度Z"),
    "indexed": ("time", "accel[0]", "accel[1]", "accel[2]", "rate[0]", "rate[1]", "rate[2]"),
    "silent": ("c1", "c2", "c3", "c4", "c5", "c6", "c7"),
}  # fmt: skip
WORDS = {"m_s2": "m/s²", "g": "g", "mg": "mg", "LSB": "LSB", "rad_s": "rad/s", "deg_s": "°/s"}
TABLES = {
    "placing": (("y",), ("outer",)),
    "vertical": (("z",), ("outer",)),
    "dual": (("x", "z"), ("outer", "inner")),
    "three": (("z", "y", "x"), ("outer", "middle", "inner")),
}


@dataclass
class Log:
    """A log and the truth of it.

    Args:
        separator, decimal, encoding, header, stated: how it is written; ``stated``: the units
            stand in brackets, in a row, or nowhere.
        time: s, ms, us, ns, epoch_s ... epoch_ns, iso, counter or none.
        rate: samples a second, Hz; force, rates: units.
        frame: turns or mirrors the axes of both, or the gyro against the accelerometer.
        table: kind of table that is read out in two columns of angles; empty: by hand.
        comments: lines before the header.
    """

    separator: str = "comma"
    decimal: str = "point"
    encoding: str = "utf-8"
    header: str = "short"
    stated: str = "nowhere"
    time: str = "s"
    rate: float = 100.0
    force: str = "m_s2"
    rates: str = "rad_s"
    frame: str = "same"
    table: str = ""
    comments: tuple[str, ...] = ()
    inside: str = ""
    doubts: tuple[str, ...] = field(default=())

    def motion(self):
        """Attitudes and table angles of rests and turns between them."""
        seconds = 60
        n = round(seconds * self.rate)
        t = np.arange(n) / self.rate
        rng = np.random.default_rng(7)
        if not self.table:
            stops = Rotation.random(11, rng)
            steps = [(a.inv() * b).as_rotvec() for a, b in itertools.pairwise(stops)]
            turned, base = np.zeros((n, 3)), np.zeros(n, dtype=int)
            for k, step in enumerate(steps):
                share = smooth((t - 3 - 5.5 * k) / 2.5)
                inside = (t >= 3 + 5.5 * k) & (t < 3 + 5.5 * (k + 1))
                base[inside] = k
                turned[inside] = share[inside, None] * step
            last = t >= 3 + 5.5 * len(steps)
            base[last], turned[last] = len(steps), 0.0
            return t, stops[base] * Rotation.from_rotvec(turned), np.zeros((n, 0))
        directions, _ = TABLES[self.table]
        goals = rng.integers(0, 12, (11, len(directions))) * 30.0 - 150.0
        angles = np.tile(goals[0], (n, 1))
        for k, (a, b) in enumerate(itertools.pairwise(goals)):
            angles += smooth((t - 3 - 5.5 * k) / 2.5)[:, None] * (b - a)
        attitude = Rotation.identity(n)
        for k, axis in enumerate(directions):
            attitude = attitude * Rotation.from_euler(axis, angles[:, [k]], degrees=True)
        return t, attitude, angles

    def readings(self):
        """(n, 3) force and rate in their units, time, angles."""
        t, attitude, angles = self.motion()
        rng = np.random.default_rng(11)
        f = attitude.inv().apply([0, 0, G])
        w = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * self.rate
        w = np.vstack([w, w[-1:]]) + np.array([0.01, -0.02, 0.015])
        f, w = f + rng.normal(0, 0.02, f.shape), w + rng.normal(0, 2e-3, w.shape)
        if self.frame == "ned":
            f, w = f * [1, -1, -1], w * [1, -1, -1]
        elif self.frame == "permuted":
            f, w = f[:, [1, 2, 0]], w[:, [1, 2, 0]]
        elif self.frame == "gravity":
            f = -f
        elif self.frame == "mirrored":
            f, w = f * [1, 1, -1], w * [1, 1, -1]
        elif self.frame == "crossed":
            w = w[:, [2, 0, 1]]
        f, w = f * FORCE[self.force], w * RATE[self.rates]
        f = np.round(f) if self.force == "LSB" else np.round(f, 5 if self.force != "mg" else 2)
        w = np.round(w) if self.rates == "LSB" else np.round(w, 5)
        return t, f, w, angles

    def clock(self, t):
        """The cells of the time column; None where there is none."""
        unit = {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}
        if self.time == "none":
            return None
        if self.time == "counter":
            return [str(k) for k in range(len(t))]
        if self.time == "iso":
            stamps = [START + timedelta(seconds=float(x)) for x in t]
            return [f"{s:%Y-%m-%dT%H:%M:%S}.{s.microsecond:06d}Z" for s in stamps]
        if self.time == "date":
            stamps = [START + timedelta(seconds=float(x)) for x in t]
            return [f"{s:%Y-%m-%d %H:%M:%S}.{s.microsecond // 1000:03d}" for s in stamps]
        epoch, _, name = self.time.rpartition("_")
        first = START.timestamp() if epoch else 4.25
        scale = unit[name]
        if name == "s":
            return [f"{first + x:.6f}" for x in t]
        zero = round(first * scale)
        return [str(zero + round(x * scale)) for x in t]

    def columns(self):
        """(name, cells) of each column."""
        t, f, w, angles = self.readings()
        names = HEADERS.get(self.header, HEADERS["short"])
        clock = self.clock(t)
        found = [] if clock is None else [(names[0], clock)]

        def cells(values, whole):
            texts = [f"{v:.0f}" if whole else f"{v:.6g}" for v in values]
            return [x.replace(".", ",") for x in texts] if self.decimal == "comma" else texts

        if clock is not None and self.decimal == "comma" and self.time not in ("iso", "date"):
            found = [(names[0], [c.replace(".", ",") for c in clock])]
        found += [(names[1 + k], cells(f[:, k], self.force == "LSB")) for k in range(3)]
        found += [(names[4 + k], cells(w[:, k], self.rates == "LSB")) for k in range(3)]
        found += [
            (f"encoder {k + 1}", cells(angles[:, k], whole=False)) for k in range(angles.shape[1])
        ]
        return found

    def write(self, path):
        """Write the log."""
        columns, mark = self.columns(), MARKS[self.separator]
        units = [""] * (len(columns) - 6 - self.angles) + [WORDS[self.force]] * 3
        units += [WORDS[self.rates]] * 3 + ["deg"] * self.angles
        names = [name for name, _ in columns]
        if self.stated == "brackets":
            names = [f"{n} [{u}]" if u else n for n, u in zip(names, units, strict=True)]
        lines = list(self.comments)
        if self.header != "none":
            lines.append(mark.join(names))
        if self.stated == "row":
            lines.append(mark.join(units if units[0] else ["[s]", *units[1:]]))
        rows = [mark.join(cells) for cells in zip(*(c for _, c in columns), strict=True)]
        if self.inside:
            rows.insert(40, self.inside)
        path.write_bytes(("\n".join([*lines, *rows]) + "\n").encode(self.encoding))
        return path

    @property
    def angles(self):
        return len(TABLES[self.table][0]) if self.table else 0

    def expected(self):
        """What a mapping says: (time column, its unit), {column: channel}."""
        columns = [name for name, _ in self.columns()]
        shown = columns if self.header != "none" else list(range(1, len(columns) + 1))
        if self.stated == "brackets":
            units = [WORDS[self.force]] * 3 + [WORDS[self.rates]] * 3 + ["deg"] * self.angles
            skip = len(columns) - len(units)
            shown = [n if k < skip else f"{n} [{units[k - skip]}]" for k, n in enumerate(columns)]
        clocked = self.time not in ("none", "counter")
        first = len(columns) - 6 - self.angles
        to = [f"accel_{a}_{self.force}" for a in "xyz"] + [f"gyro_{a}_{self.rates}" for a in "xyz"]
        if self.table:
            to += [f"table_{axis}_deg" for axis in TABLES[self.table][1]]
        unit = {"iso": "iso", "date": "iso"}.get(self.time, self.time.rpartition("_")[2])
        return (shown[0] if clocked else None, unit), dict(zip(shown[first:], to, strict=True))


def smooth(x):
    """0 to 1 with zero rates at both ends."""
    x = np.clip(x, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x**2)


def score(log, text):
    """(item, right | cannot know | wrong) of a proposed mapping."""
    found = tomllib.loads(text)
    file, time = found["file"], found["time"]
    same = {"utf-8-sig": "utf-8", "utf-16-le": "utf-16-le", "gbk": "gb18030"}
    wide = {"utf-16", "utf-16-le", "utf-16-be"}
    encoding = same.get(log.encoding, log.encoding)
    plain = encoding in ("cp1252", "gb18030", "utf-8") and file["encoding"] == "utf-8"
    ascii_only = plain and "ASCII" in text
    items = [
        ("separator", verdict(file["separator"] == log.separator)),
        ("decimal", verdict(file["decimal"] == log.decimal)),
        ("encoding", verdict(file["encoding"] == encoding or ascii_only
                             or {file["encoding"], encoding} <= wide)),
    ]  # fmt: skip
    (column, unit), channels = log.expected()
    if column is None:
        unknown = "?" in (time.get("rate_hz"), time.get("unit"))
        items.append(
            ("rate", "cannot know" if unknown else verdict(time.get("rate_hz") == log.rate))
        )
    else:
        items.append(("time column", verdict(time.get("column") == column)))
        known = time.get("unit")
        items.append(("time unit", "cannot know" if known == "?" else verdict(known == unit)))
    proposed = {c["from"]: c["to"] for c in found["column"]}
    for name, to in channels.items():
        said = proposed.get(name)
        if said is None:
            items.append((to, "cannot know" if str(name) in left_out(text) else "wrong"))
        else:
            same_place = said.endswith("_?") and to.startswith(said[:-1])
            items.append((to, "cannot know" if same_place else verdict(said == to)))
    items += [(f"extra {said}", "wrong") for name, said in proposed.items() if name not in channels]
    doubts = "\n".join(line for line in text.splitlines() if line.startswith("# cannot know"))
    items += [(f"doubt {word}", verdict(word in doubts)) for word in log.doubts]
    return items


def verdict(right):
    return "right" if right else "wrong"


def left_out(text):
    return next((x for x in text.splitlines() if x.startswith("# left out")), "") + "\n".join(
        x for x in text.splitlines() if x.startswith("# cannot know")
    )


ROW = {"stated": "row"}
VARIANTS = {
    "plain": Log(),
    "semicolon, decimal comma": Log(separator="semicolon", decimal="comma"),
    "tab": Log(separator="tab", header="long"),
    "tab, decimal comma": Log(separator="tab", decimal="comma", header="long"),
    "spaces, no header": Log(separator="space", header="none"),
    "spaces, decimal comma": Log(separator="space", decimal="comma", header="none"),
    "pipe": Log(separator="pipe"),
    "byte order mark": Log(encoding="utf-8-sig", header="dotted"),
    "UTF-16": Log(encoding="utf-16", separator="tab"),
    "UTF-16 without mark": Log(encoding="utf-16-le", separator="semicolon", decimal="comma"),
    "UTF-16 big-endian": Log(encoding="utf-16-be"),
    "GBK": Log(encoding="gbk", header="chinese"),
    "Western units": Log(encoding="cp1252", stated="brackets", rates="deg_s"),
    "UTF-8 Chinese": Log(header="chinese", separator="tab"),
    "unit row": Log(stated="row", header="long"),
    "unit row, semicolon": Log(stated="row", separator="semicolon", decimal="comma", rates="deg_s"),
    "brackets, g": Log(stated="brackets", force="g", rates="deg_s"),
    "g, no word of it": Log(force="g"),
    "mg": Log(force="mg", rates="deg_s"),
    "counts": Log(force="LSB", rates="LSB"),
    "counts said": Log(force="LSB", rates="LSB", stated="brackets"),
    "deg/s": Log(rates="deg_s"),
    "milliseconds": Log(time="ms"),
    "microseconds": Log(time="us"),
    "nanoseconds": Log(time="ns"),
    "Unix seconds": Log(time="epoch_s"),
    "Unix milliseconds": Log(time="epoch_ms", header="long"),
    "Unix microseconds": Log(time="epoch_us"),
    "Unix nanoseconds": Log(time="epoch_ns"),
    "ISO": Log(time="iso"),
    "ISO with a space": Log(time="date", separator="semicolon", decimal="comma"),
    "counter": Log(time="counter"),
    "no time": Log(time="none", separator="space", header="none"),
    "rate in a comment": Log(time="none", comments=("# Output Rate: 100 Hz", "# made by us")),
    "Xsens comments": Log(separator="tab", comments=("// Start: 0", "// Update Rate: 100.0Hz")),
    "10 Hz": Log(rate=10.0),
    "102.4 Hz": Log(rate=102.4, time="ms"),
    "1000 Hz": Log(rate=1000.0, time="us"),
    "2000 Hz, GB, no names": Log(rate=2000.0, time="us", header="silent"),
    "north east down": Log(frame="ned"),
    "axes permuted": Log(frame="permuted", rates="deg_s"),
    "gravity, not force": Log(frame="gravity"),
    "left-handed": Log(frame="mirrored", doubts=("left-handed",)),
    "gyro axes crossed": Log(frame="crossed", doubts=("gravity does not follow",)),
    "dual table": Log(table="dual"),
    "placing table": Log(table="placing", rates="deg_s"),
    "vertical table": Log(table="vertical"),
    "three-axis table": Log(table="three", separator="semicolon", decimal="comma"),
    "indexed names": Log(header="indexed", time="us"),
    "comments inside": Log(inside="# operator: knocked", comments=("Device: X", "Serial: 12")),
}  # fmt: skip
