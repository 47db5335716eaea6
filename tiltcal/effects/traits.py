"""Properties of an effect in addition to its equation. Diagnosis, design and simulation ask for it
here and never for the id, so that an effect of another package is treated like any other.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

from tiltcal.effects.spans import CoordinateRanges


@dataclass(frozen=True)
class Family:
    """Curves and effects that complete the textbook form of an effect.

    They keep where the effect acts and what it follows. ``{axis}`` stands for its table axis.

    Args:
        reading: coordinates of curves that are added to its channel.
        scale: coordinates of curves that multiply the input of its channel.
        across: coordinates of curves that multiply the force along another axis.
        readout: coordinates of errors of its axis' readout.
        tilt: (slot, coordinate) of tilts of a frame.
        effects: ids of effects of the same sensor.
    """

    reading: tuple[str, ...] = ()
    scale: tuple[str, ...] = ()
    across: tuple[str, ...] = ()
    readout: tuple[str, ...] = ()
    tilt: tuple[tuple[str, str], ...] = ()
    effects: tuple[str, ...] = ()

    def has_tilt(self, slot: str, coordinate: str, axis: str | None) -> bool:
        """Whether a tilt of a frame that follows a coordinate completes the form."""
        pairs = ((s.format(axis=axis), c.format(axis=axis)) for s, c in self.tilt)
        return (slot, coordinate) in pairs


class Traits:
    """Properties of an effect; each default is that of most effects."""

    # What it is to an instrument
    calibration_term: ClassVar[str] = ""
    """Name by which a sensor's ``adjustable`` terms free it, such as ``bias``."""
    ordinary: ClassVar[bool] = False
    """Every instrument of its kind, or every table, has it."""

    # Its functional form
    row_wise: ClassVar[bool] = False
    """What it does to a row of a sequence's recording depends on no other row."""
    rows_apart: ClassVar[bool] = False
    """It takes more from a whole course, but can act where rows have their own motion alone."""
    same_form_as: ClassVar[str] = ""
    """Id of an effect with the same readings under all circumstances, which stands for both."""
    apart_on_joints: ClassVar[bool] = False
    """On a user's own model both are looked for: there either is as common."""
    form: ClassVar[Literal["law", "any", "unknown"]] = "law"
    """Whether the name implies a functional form, is valid for any curve, or stands for curves
    only.
    """
    family: ClassVar[Family] = Family()
    superposes: ClassVar[bool] = False
    """It may act at several shapes at once: findings at further shapes belong to the first."""
    alike_on_axes: ClassVar[bool] = False
    """All axes of the table have it alike: findings on further axes belong to the first."""
    products_of: ClassVar[str] = ""
    """An input, ``force`` or ``rate``: the name is valid for products of two of its
    components too.
    """
    harmonic: ClassVar[int] = 0
    """Order over the angle of its table axis; 0: none."""
    threshold: ClassVar[bool] = False
    """Its parameter is a level at which it begins to act: readings are not in proportion to it."""
    acts_from_an_instant: ClassVar[bool] = False
    """It begins at its parameter ``time``."""
    like_event: ClassVar[str] = ""
    """Id of the event that looks the same between two recordings: it is redrawn for each."""
    spectral_line: ClassVar[Literal["", "time", "angle"]] = ""
    """It is a narrow line in the spectrum over time, or over the angle of an axis."""
    wander: ClassVar[float] = 0.0
    """How far its line may move about its frequency, Hz; 0: it keeps to it."""

    # Where and when it shows
    seen_by_encoder: ClassVar[bool] = False
    """The encoder sees it: it shows only where the readout is the command."""
    of_drive: ClassVar[bool] = False
    """The drive leaves it, so that an encoder beside the command reads it as well."""
    shows_against_table: ClassVar[bool] = False
    """Nothing but the angles of a table shows it."""
    of_model: ClassVar[bool] = False
    """Only the links of a user's own model have it."""
    on_slides: ClassVar[bool] = False
    """It acts on an axis that slides as on one that turns."""
    axis_by_gravity: ClassVar[bool] = False
    """It acts on the axis that gravity loads, where none is named."""
    lags_thermometer: ClassVar[bool] = False
    """It follows a temperature that lags behind the thermometer's."""
    erased_by_shaking: ClassVar[bool] = False
    """What it remembers is lost when a hand shakes the instrument."""
    frame_convention: ClassVar[tuple[str, ...]] = ()
    """Sizes that only state how the body's axes are chosen, where no table shows them."""
    leaves_nothing: ClassVar[bool] = False
    """It belongs to one recording: the next one does not meet it, or not in the same phase."""

    # What it does to data
    mislabels: ClassVar[bool] = False
    """A column means something else than its name states."""
    repair: ClassVar[Literal["", "columns", "samples"]] = ""
    """What is put right before anything is fitted: whole columns, or the samples that it spoils."""
    scatters: ClassVar[bool] = False
    """It sets each stop or each stamp elsewhere by chance: no re-simulation repeats it."""

    # As text
    follows: ClassVar[str] = ""
    """Coordinate that it follows, where its needs do not state it; ``{innermost}`` stands for the
    innermost table axis.
    """
    distinguished_by: ClassVar[Mapping[str, str]] = {}
    """What to record to distinguish it from another id: a kind of block, or a phrase."""

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        """Shapes at which a scan tries it, SI; none where the recordings cannot show it."""
        return [{}]

    @classmethod
    def shape_odds(cls, shape: Mapping[str, float], span: CoordinateRanges) -> float:
        """Natural logarithm of the odds of a shape against an unlisted form of that shape, in
        addition to the odds of the effect; 0: the shape is not informative.
        """
        return 0.0
