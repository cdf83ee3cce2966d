"""A certificate as text and tables, for `companion certify`."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterable

from rich.console import Console
from rich.table import Column, Table

from companion.surrogate.certificates import Certificate, Finding, SpeedGroup, ThreatDistance

CERTIFICATE_COLUMNS = 140
"""Width of the certificate's tables, also in a pipe."""
TEXT_COLUMNS = 120
"""Greatest width of the text around the tables, which is wrapped at the console's width if that is less."""


def certificate_text(certificate: Certificate) -> str:
    """Return the text that `companion certify` prints of a certificate."""
    console = Console(soft_wrap=True, highlight=False, markup=False, width=CERTIFICATE_COLUMNS)
    with console.capture() as capture:
        console.print(
            _wrapped(
                f"{certificate.mission}, seed {certificate.seed}, surrogate {certificate.surrogate}; lengths in m, a "
                f"step is {certificate.guidance_step_s:g} s"
            )
        )
        for group in certificate.groups:
            console.print(f"\nagents at {group.speed_m_s:g} m/s: {len(group.agents)}")
            console.print(_findings_table(group))
            for finding in group.findings:
                if finding.why_not is not None:
                    console.print(_wrapped(f"{finding.title} does not hold: {finding.why_not}"))
        if certificate.sources:
            subject = (
                "The profile's steepness alone allows"
                if certificate.surrogate == "analytic"
                else "The network's weights alone allow"
            )
            bound = f"|dF*/dx| up to {certificate.corollary.component_bound_m:.4g} m"
            console.print("\n" + _wrapped(f"{subject} {bound}; the corollary asks for at most b."))
        console.print("\nAssumptions")
        for assumption in certificate.assumptions:
            answer = {True: "yes", False: "NO", None: "open"}[assumption.holds]
            console.print(_wrapped(f"  {answer:4}  {assumption.name}: {assumption.text}", 8 * " "))
        console.print("\n" + _wrapped(certificate.exclusion))
        if any(finding.holds for group in certificate.groups for finding in group.findings):
            console.print(
                "\n"
                + _wrapped(
                    f"Steps to within {certificate.arrival_radius_m:g} m, at most. Line clear: by which bounds the "
                    "straight way keeps its distance from every threat's start."
                )
            )
            for assumption in certificate.assumptions:
                if assumption.voids and any(
                    finding.somewhere for group in certificate.groups for finding in group.findings
                ):
                    console.print(
                        _wrapped(
                            f"Void in flight: {', '.join(assumption.voids)}. Their steps hold only with "
                            f"{assumption.name}, as the theorem assumes."
                        )
                    )
            console.print(_bounds_table(certificate), end="")
    return capture.get().rstrip("\n")


def _wrapped(text: str, indent: str = "") -> str:
    width = min(TEXT_COLUMNS, shutil.get_terminal_size((TEXT_COLUMNS, 24)).columns)
    return textwrap.fill(text, max(width, 2 * len(indent) + 20), subsequent_indent=indent, break_on_hyphens=False)


def _findings_table(group: SpeedGroup) -> Table:
    findings = group.findings
    table = Table(
        Column("figure", no_wrap=True), *(Column(finding.title, justify="right", no_wrap=True) for finding in findings)
    )

    def add(name: str, figures: Iterable[float | str | None], form: str = ".4g") -> None:
        cells = ("-" if at is None else at if isinstance(at, str) else f"{at:{form}}" for at in figures)
        table.add_row(name, *cells)

    add("v (m per step)", [group.step_m] * len(findings))
    add("delta (m per step)", [group.target_step_m] * len(findings))
    add("largest b", (finding.largest_b_m or None for finding in findings))
    add("stated at b", (finding.b_m or None for finding in findings))
    add("condition satisfied", ("yes" if finding.holds else "NO" for finding in findings))
    add("left of b after late targets", (finding.left_b_m for finding in findings))
    for unit, name in (("m^2", "least decrease of D^2 (m^2)"), ("m", "least decrease of D (m)")):
        add(name, (finding.decrease if finding.decrease_unit == unit else None for finding in findings))
    add("weights alone suffice (corollary)", ("yes" if finding.weights_suffice else "NO" for finding in findings))
    kinds = next((finding.threat_distances for finding in findings if finding.threat_distances), ())
    for index, kind in enumerate(kinds):
        ats = [finding.threat_distances[index] if finding.threat_distances else None for finding in findings]
        radii = f"R_d {kind.detection_radius_m:g}, R_a {kind.attack_radius_m:g}"
        threats = "1 threat" if kind.threats == 1 else f"{kind.threats} threats"
        add(f"holds beyond, from the centre ({radii}; {threats})", map(_from_centre, ats), ".0f")
        add("  from the edge of R_d", map(_from_edge, ats), ".0f")
        add("  from the centre, as heard", (None if at is None else at.as_heard_m for at in ats), ".0f")
    if any(finding.peer_distance_m is not None for finding in findings):
        add("holds beyond, from another agent", (finding.peer_distance_m for finding in findings), ".0f")
    elif not kinds:
        add("holds beyond, from threats and other agents", map(_anywhere, findings))
    add("turn needed per step (deg)", (finding.turn_needed_deg for finding in findings))
    add("turn allowed per step (deg)", [group.turn_limit_deg] * len(findings))
    add("most that F* turns the path at a disc's edge (deg)", (finding.bend_deg for finding in findings), ".2g")
    return table


def _from_centre(at: ThreatDistance | None) -> float | str | None:
    return None if at is None else at.from_centre_m or "everywhere"


def _from_edge(at: ThreatDistance | None) -> float | str | None:
    return None if at is None else at.from_edge_m if at.from_centre_m else "everywhere"


def _anywhere(finding: Finding) -> str | None:
    """Return in words where a finding without a distance holds, None if it does not hold."""
    return None if not finding.holds else "everywhere" if finding.somewhere else "nowhere known"


def _bounds_table(certificate: Certificate) -> Table:
    titles = {finding.condition: finding.title for finding in certificate.groups[0].findings}
    table = Table("agent", "target", Column("distance", justify="right"))
    for title in titles.values():
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("line clear")
    for bound in certificate.agents:
        known = {
            titles[condition]: is_clear for condition, is_clear in bound.line_clear.items() if is_clear is not None
        }
        clear = [title for title, is_clear in known.items() if is_clear]
        table.add_row(
            str(bound.agent),
            f"{bound.target}, {bound.which}",
            f"{bound.distance_m:.0f}",
            # Digits in groups of three, as in docs/convergence.md.
            *("-" if steps is None else f"{steps:,}".replace(",", " ") for steps in bound.steps.values()),
            "-" if not known else "all" if len(clear) == len(titles) else ", ".join(clear) or "none",
        )
    return table
