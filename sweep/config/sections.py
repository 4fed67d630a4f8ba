"""The campaign as the user writes it: TOML in, frozen and checked configuration out, every problem at once.

Units are in the keys. What needs the plant to be judged (f1, Nyquist, the operating range, its own
parameters) is judged where the plant is known. This module imports pydantic: import it where it is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from .file import ConfigError, apply, dotted, line_numbers, line_of, parse, place_of, read

MAX_POINTS = 1_000_000
MAX_AMPLITUDE_PU = 0.2
AUTO_LIMIT_PU = 0.02
PERIOD_S = 1.0
MIN_ADAPTIVE_POINTS = 12
DEFAULT_INTERPOLATION_TOLERANCE = 1e-3

# The description of a field says what is needed; messages print it.
Text = Annotated[str, Field(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
PerUnitVoltage = Annotated[Positive, Field(le=5)]
"""A voltage over the rated one: 690 or 400 is one in V."""

_VOLTAGE = "a number above 0 and at most 5, in pu of the rated voltage"
NotNegative = Annotated[Number, Field(ge=0)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)


class CampaignSection(_Section):
    """What the campaign is called."""

    name: Text = Field(description='a name in quotes, such as "table1"')


class PlantSection(_Section):
    """What is driven, and how carefully. ``isolate`` None: the plant's own default."""

    id: Text = Field(description='the id of a plant in quotes, such as "dpmsg-v1"')
    parameters: dict[str, Any] = Field(default={}, description="a table [plant.parameters]")
    isolate: bool | None = Field(default=None, description="true or false")
    timeout_s: Positive | None = Field(default=None, description="a number above 0, in s")
    memory_mb: Positive | None = Field(default=None, description="a number above 0, in MB")


class GridSection(_Section):
    """A Thevenin grid of one operating point, R + jX or elements; its impedance counts ``scale`` times."""

    r_ohm: NotNegative | None = Field(default=None, description="a number of at least 0, in ohm")
    x_ohm: Positive | None = Field(default=None, description="a number above 0, in ohm at f1")
    elements: dict[str, Any] | None = Field(
        default=None, description='the name of a file of elements, such as "grid.toml", in place of r_ohm and x_ohm'
    )
    voltage_pu: PerUnitVoltage = Field(default=1.0, description=_VOLTAGE)
    scale: Positive = Field(default=1.0, description="a number above 0, multiplies r_ohm and x_ohm")


class OperatingPointSection(_Section):
    """One stationary condition: active and reactive power, and either |v_pcc| or the grid that decides it."""

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")] = Field(
        description="a name of letters, digits, '_', '.' and '-', in quotes"
    )
    active_power_mw: Number = Field(description="a number, in MW")
    reactive_power_mvar: Number | None = Field(
        default=None, description="a number, in Mvar out of the device; 0 unless given"
    )
    terminal_voltage_pu: PerUnitVoltage | None = Field(default=None, description=_VOLTAGE)
    grid: GridSection | None = Field(
        default=None,
        description='a table { r_ohm = 0.012, x_ohm = 0.25, voltage_pu = 1.0, scale = 1.0 }, or a file "grid.toml"',
    )


Range = Annotated[tuple[Number, Number], Field(strict=False)]


class ToleranceSection(_Section):
    """A tolerance on what is decided on grids, in place of one on Y."""

    mode_rad_s: Positive | None = Field(
        default=None, description="a number above 0, in rad/s, to which the critical mode is to be known"
    )
    verdict: Annotated[Positive, Field(lt=1)] | None = Field(
        default=None, description="a number between 0 and 1, the share of the region where the verdict may stay open"
    )
    grid: Text = Field(description='a grid or a bank in quotes, such as "0.012+0.25j", "grid.toml" or "grids/"')
    source_voltage_pu: Positive | None = Field(
        default=None, description="a number above 0, in pu, behind the grid; |v_pcc| then follows from the load flow"
    )


def _kind_of_tolerance(value: Any) -> str:
    return "table" if isinstance(value, Mapping | ToleranceSection) else "number"


Tolerance = Annotated[
    Annotated[Positive, Field(lt=1), Tag("number")] | Annotated[ToleranceSection, Tag("table")],
    Discriminator(_kind_of_tolerance),
]


class OperatingPointsSection(_Section):
    """A region of operating points, swept where a surrogate over it is least sure, until it is certified."""

    active_power_mw: Range | Number = Field(description="a range [low, high] or a number, in MW")
    reactive_power_mvar: Range | Number = Field(default=0.0, description="a range [low, high] or a number, in Mvar")
    terminal_voltage_pu: Range | Number = Field(default=1.0, description="a range [low, high] or a number, in pu")
    parameters: dict[str, Range | Number] | None = Field(
        default=None,
        description="a table { name = [low, high] } of the plant's parameters that are axes, or one number for each",
    )
    tolerance: Tolerance = Field(
        default=1e-3,
        description="a number between 0 and 1, the relative error of Y to certify over the region, or a table "
        '{ mode_rad_s = 0.01, grid = "0.012+0.25j" } or { verdict = 0.02, grid = "grids/" }',
    )
    most: Annotated[int, Field(ge=8, le=1000)] = Field(
        default=40, description="a whole number from 8 to 1000, the operating points at which it gives up"
    )
    most_minutes: Positive | None = Field(
        default=None, description="a number above 0, the minutes after which no further operating point is begun"
    )
    seed: Annotated[int, Field(ge=0)] = Field(
        default=0, description="a whole number of at least 0, of the first design"
    )


class SweepSection(_Section):
    """Which frequencies, how exactly, how long at most: a range with ``points``, or the list ``f_hz``."""

    f_min_hz: Positive | None = Field(default=None, description="a number above 0, in Hz")
    f_max_hz: Positive | None = Field(default=None, description="a number above f_min_hz, in Hz")
    points: Annotated[int, Field(ge=2, le=MAX_POINTS)] | None = Field(
        default=None, description=f"a whole number from 2 to {MAX_POINTS}"
    )
    spacing: Literal["log", "linear", "adaptive"] = Field(
        default="log", description='"log", "linear" or "adaptive" (points is then the most it may take)'
    )
    interpolation_tolerance: Annotated[Positive, Field(lt=1)] | None = Field(
        default=None,
        description='a number between 0 and 1, the interpolation error an "adaptive" grid is to be certified for',
    )
    f_hz: Annotated[tuple[Positive, ...], Field(strict=False)] | None = Field(
        default=None, description="a list of increasing frequencies above 0, in Hz, such as [1.0, 10.0, 75.5]"
    )
    operating_points: OperatingPointsSection | None = Field(
        default=None, description="a section [sweep.operating_points], in place of [[operating_point]]"
    )
    tolerance: Annotated[Positive, Field(lt=1)] = Field(
        default=1e-5, description="a number between 0 and 1, the agreement asked of successive windows"
    )
    uncertainty: Annotated[Positive, Field(lt=1)] = Field(
        default=0.003, description="a number between 0 and 1, the relative standard error asked where a plant is noisy"
    )
    probes: Annotated[int, Field(ge=0, le=MAX_POINTS)] | None = Field(
        default=None, description="a whole number of at least 0, the rows that are swept at half the amplitude as well"
    )
    nonlinear_above: Positive = Field(
        default=0.005, description="a number above 0, the relative change of Y with the amplitude that is accepted"
    )
    max_simulated_s: Positive = Field(default=60.0, description="a number above 0, in s, the limit of one shot")


class InjectionSection(_Section):
    """The perturbation; ``amplitude_pu`` is its peak over the rated peak."""

    kind: Literal["series_voltage", "shunt_current"] = Field(
        default="series_voltage", description='"series_voltage" or "shunt_current"'
    )
    signal: Literal["tone", "multisine", "prbs", "qrb", "chirp"] = Field(
        default="tone", description='"tone", "multisine", "prbs", "qrb" or "chirp"'
    )
    period_s: Positive | None = Field(
        default=None, description="a number above 0, in s, the period of a broadband signal (1 s unless given)"
    )
    amplitude_pu: Annotated[Positive, Field(le=MAX_AMPLITUDE_PU)] | Literal["auto"] = Field(
        default=0.0005,
        description=f'a number above 0 and at most {MAX_AMPLITUDE_PU:g}, in pu (peak over rated peak), or "auto"',
    )
    amplitude_max_pu: Annotated[Positive, Field(le=MAX_AMPLITUDE_PU)] | None = Field(
        default=None,
        description=f'a number above 0 and at most {MAX_AMPLITUDE_PU:g}, in pu, the limit of "auto"',
    )

    @property
    def largest_pu(self) -> float:
        """The amplitude, or the limit of an automatic one (pu)."""
        return (self.amplitude_max_pu or AUTO_LIMIT_PU) if self.amplitude_pu == "auto" else self.amplitude_pu


class FriendlyGrid(_Section):
    """An impedance behind which a device settles that cannot be started cold where it is to be swept."""

    r_ohm: NotNegative = Field(default=0.0, description="a number of at least 0, in ohm")
    x_ohm: Positive = Field(description="a number above 0, in ohm at f1")


class SourceSection(_Section):
    """What feeds the PCC; the reactance is that at f1."""

    kind: Literal["ideal", "thevenin"] = Field(default="ideal", description='"ideal" or "thevenin"')
    r_ohm: NotNegative = Field(default=0.0, description="a number of at least 0, in ohm")
    x_ohm: NotNegative = Field(default=0.0, description="a number above 0 for a thevenin source, in ohm at f1")
    grid: GridSection | None = Field(
        default=None, description='the name of a file of elements, such as "grid.toml", in place of r_ohm and x_ohm'
    )
    settle_on: FriendlyGrid | None = Field(
        default=None, description="a table { r_ohm = 0.0, x_ohm = 0.1 }, the grid on which the device is settled first"
    )


class Config(_Section):
    """A whole campaign. `load_config` and `Config.from_dict` are the ways in: they also check what
    one section says about another.
    """

    campaign: CampaignSection = Field(description="a section [campaign]")
    plant: PlantSection = Field(description="a section [plant]")
    operating_point: Annotated[tuple[OperatingPointSection, ...], Field(strict=False)] = Field(
        default=(), description="at least one section [[operating_point]], in double brackets"
    )
    sweep: SweepSection = Field(description="a section [sweep]")
    injection: InjectionSection = Field(default=InjectionSection(), description="a section [injection]")
    source: SourceSection = Field(default=SourceSection(), description="a section [source]")

    def to_dict(self) -> dict[str, Any]:
        """Plain values that JSON knows, every default filled in; `from_dict` rebuilds the campaign."""
        return self.model_dump(mode="json", exclude_none=True)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Config:
        """The campaign that `to_dict` gave, or that a TOML file holds.

        Raises
        ------
        ConfigError
            With every problem; without file and line, there being none.
        """
        from .checks import checked  # late: it knows the sections above

        config, problems = checked(data, Path())
        if config is None:
            raise ConfigError([f"{dotted(keys)}: {text}" for keys, text in problems])
        return config


def load_config(path: str | Path, overrides: Sequence[str] = ()) -> Config:
    """Read and check a campaign.

    Parameters
    ----------
    path : path
        TOML file, UTF-8.
    overrides : sequence of str
        ``"section.key=value"`` with the value as TOML writes it; entries of a list by number, as in
        ``"operating_point.0.active_power_mw=0.7"``. The last one wins.

    Raises
    ------
    ConfigError
        With every problem, each at its line or its override.
    """
    from .checks import checked

    text = read(Path(path))
    data = parse(text, path)
    settings = apply(overrides, data)
    config, problems = checked(data, Path(path).parent)
    if config is None:
        lines = line_numbers(text, parse(text, path))
        in_order = sorted(problems, key=lambda problem: line_of(problem.keys, lines) or 0)
        raise ConfigError([f"{place_of(path, p.keys, lines, settings)}: {dotted(p.keys)}: {p.text}" for p in in_order])
    return config
