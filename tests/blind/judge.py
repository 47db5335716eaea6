"""One answer against the truth: plain data in, plain data out."""

import math
from typing import Any

Plain = dict[str, Any]
CLAIMS = ("explained", "ambiguous", "unlisted")
# faults that leave the same trace in the file
TWINS = (
    {"acc_saturation", "gyr_saturation"},
    {"adc_quantisation", "gyr_quantisation", "data_truncation"},
    {"data_outlier", "emi_spike"},
    {"data_drop", "data_gap"},
    {"table_index_error", "table_wobble_async"},
)
# any small tilt is three of its six numbers; it is not drawn itself
CONTAINED = {"mount_thermal_tilt": "acc_temp_misalign"}
# one and the same seen by a single axis
TURNED = {
    "data_sign",
    "data_hand",
    "data_rotation_sense",
    "data_axis_swap",
}


def judge(truth: Plain, answer: Plain | None, heldout: float | None) -> Plain:
    """Everything the table counts. ``answer``: diagnosis.json; ``heldout``: rms of the prediction
    in units of sample noise.
    """
    findings = (answer or {}).get("findings") or []
    verdict = (answer or {}).get("verdict")
    said = {k: truth[k] for k in ("kind", "type", "walk", "flicker")}
    said |= {"author": truth.get("author", "first"), "nuisance": truth.get("nuisance")}
    said |= {
        "verdict": verdict,
        "claims": verdict in CLAIMS,
        "crashed": answer is None,
        "truth": [e["id"] for e in truth["effects"]],
        "findings": [f.get("effect") for f in findings],
        "classes": [f.get("class") for f in findings],
        "lambda": [e["lambda"] for e in truth["effects"]],
        "verdict_right": verdict in expected(truth),
    }
    if truth["type"] == "null":
        said["p_min"] = min([f.get("p_value", 1.0) for f in findings], default=None)
    if statements := stated(truth, findings):
        said["stated"] = statements
    if "heldout" in truth:
        said["heldout"] = {**truth["heldout"], "product": heldout}
    alone = len(truth["effects"]) == 1
    said["effects"] = [
        _effect(e, findings, truth["kind"], verdict, alone)
        for e in truth["effects"]
        if truth["type"] != "impossible"
    ]
    return said


def expected(truth: Plain) -> tuple[str, ...]:
    """Right verdicts."""
    if truth["type"] in ("null", "impossible"):
        return ("match", "cannot_tell") if truth["kind"].startswith("six") else ("match",)
    if truth["type"] == "unlisted":
        return ("unlisted",)
    if truth["type"] == "data" or any(
        set(e["tolerated"]) != set(e["inseparable"]) for e in truth["effects"]
    ):
        return "explained", "ambiguous"
    return ("ambiguous",) if any(e["inseparable"] for e in truth["effects"]) else ("explained",)


def _effect(e: Plain, findings: list[Plain], kind: str, verdict: str | None, alone: bool) -> Plain:
    said = {"id": e["id"], "lambda": e["lambda"], "textbook": e["textbook"], "listed": e["listed"]}
    return said | (
        _listed(e, findings, kind, alone) if e["listed"] else _unlisted(e, findings, verdict)
    )


def right_names(e: Plain, kind: str) -> set[str]:
    """Every name of what is concealed."""
    if not e["listed"]:
        return {"unlisted"}
    right = {e["id"]}.union(*(t for t in TWINS if e["id"] in t))
    turned = e["id"] in TURNED and kind in ("placing_sweep", "vertical_turn")
    return right | TURNED if turned else right


def stated(truth: Plain, findings: list[Plain]) -> Plain:
    """(probability stated, whether it is so) of every finding that states one: that something is
    there, and of its likeliest name. What nobody can see is left out.
    """
    out: Plain = {}
    if truth["type"] == "impossible":
        return out
    right: set[str] = set()
    for e in truth["effects"]:
        right |= right_names(e, truth["kind"])
    for f in findings:
        if "probability" in f:
            out.setdefault("exists", []).append([f["probability"], bool(truth["effects"])])
        if f.get("names"):
            name, p = max(f["names"].items(), key=lambda item: item[1])
            out.setdefault("name", []).append([p, name in right])
    return out


def _listed(e: Plain, findings: list[Plain], kind: str, alone: bool) -> Plain:
    right = right_names(e, kind)
    allowed = right | set(e["tolerated"]) | set(e["inseparable"])
    allowed |= {CONTAINED[id] for id in allowed & set(CONTAINED)}
    first = findings[:1] if alone else findings
    named = [f for f in first if f.get("effect") in right]
    held = [f for f in first if right & set(f.get("class") or [])]
    honest = [f for f in held if set(f["class"]) <= allowed]
    f = next(iter(named or honest or held or first), None)
    certain = [x for x in findings if x.get("effect") and len(x.get("class") or [0]) <= 1]
    return {
        "named": bool(named),
        "in_class": bool(held or named),
        "honest": bool(honest),
        "good": bool(named or honest),
        "wrong_certain": alone
        and any(x["effect"] not in right | set(e["inseparable"]) for x in certain),
        "false_certainty": bool(e["inseparable"]) and any(x["effect"] in right for x in certain),
        "padded": sorted(set().union(*(set(x["class"]) for x in held)) - allowed),
        "stage_right": bool(f and (named or honest))
        and _same_stage(f["stage"], e["stage"], honest, named),
        "pulls": pulls(f, e) if f and f in named and e["textbook"] and e["lambda"] else [],
    }


def _same_stage(found: str, true: str, honest: list[Plain], named: list[Plain]) -> bool:
    """An honest class led by a twin of another stage is right as far as anybody can tell."""
    return found == true or {found, true} == {"data", "timing"} or bool(honest and not named)


def _unlisted(e: Plain, findings: list[Plain], verdict: str | None) -> Plain:
    unnamed = [f for f in findings if f.get("effect") is None]
    names = [f for f in findings if f.get("effect")]
    where = next(iter(unnamed or findings), None)
    main = max(e["energy"], key=e["energy"].get, default="")
    return {
        "said": verdict == "unlisted" or bool(unnamed),
        "wrong_certain": verdict == "explained"
        and any(f["effect"] not in e["inseparable"] for f in names),
        "certain_name": any(len(f.get("class") or [0]) == 1 for f in names),
        "channel": bool(where) and _channel(where, main),
        "coordinate": bool(where) and (where.get("where") or {}).get("coordinate") in e["where"],
    }


def _channel(finding: Plain, main: str) -> bool:
    axes = {str(a).split(".")[-1] for a in finding.get("axes") or []}
    return not main or (
        (not axes or main.split(".")[-1] in axes)
        and main.split(".")[0] in (finding.get("sensors") or [main.split(".")[0]])
    )


def pulls(finding: Plain, e: Plain) -> list[float]:
    """|value - truth| / sigma of the parameters that both name; of a tone, whose phase is not
    named, the size only.
    """
    out = []
    for name, true in e["parameters"].items():
        told = (finding.get("parameters") or {}).get(name)
        if isinstance(told, dict) and told.get("sigma") and isinstance(true, (int, float)):
            size = abs if name.startswith("pickup") else float
            out.append(abs(size(told["value"]) - size(true)) / abs(told["sigma"]))
    return [p for p in out if math.isfinite(p)]
