"""Ask a person what a proposed mapping leaves open, on stderr and stdin alone: stdout is for what a command answers."""

import sys
from typing import TYPE_CHECKING

import typer

from leactl.errors import Stopped

if TYPE_CHECKING:
    from leactl.runfile.importing.proposal.proposal import OpenQuestion, Proposal
    from leactl.runfile.importing.proposal.survey import Survey


def is_attended() -> bool:
    """Whether somebody can be asked."""
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def asked(seen: "Survey") -> "Proposal":
    """The proposal with every question answered, each asked only where the answers before it leave it open.

    Raises
    ------
    Stopped : the person ends the input.
    """
    from leactl.runfile.importing.proposal.proposal import propose

    answers: dict[tuple[str, ...], str] = {}
    proposal = propose(seen, answers)
    typer.echo(proposal.text, err=True)
    while proposal.questions:
        question = proposal.questions[0]
        answers[question.key] = answer(question)
        proposal = propose(seen, answers)
    if answers:
        typer.echo(proposal.text, err=True)  # with what follows from the answers
    return proposal


def answer(question: "OpenQuestion") -> str:
    """One answer that can be used; asks again until it is."""
    from leactl.runfile.importing.proposal.channels import LEAVE_OUT
    from leactl.runfile.importing.proposal.proposal import accepted_answer

    typer.echo(question.text, err=True)
    for number, choice in enumerate(question.choices, start=1):
        typer.echo(f"  {number}  {choice}", err=True)
    leaves_out = f", {LEAVE_OUT} leaves it out" if question.may_be_left_out else ""
    what = f"1 to {len(question.choices)}, or in words" if question.choices else "a number"
    while True:
        typer.echo(f"{what}{leaves_out}: ", err=True, nl=False)
        line = sys.stdin.readline()
        if not line:
            raise Stopped("no answer; nothing is imported")
        given = accepted_answer(question, line)
        if given is not None:
            return given
        typer.echo(f"{line.strip()!r} is no answer", err=True)
