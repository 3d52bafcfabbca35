"""Ask the user the open questions of a proposed mapping, on stderr and stdin; stdout is for the command's output."""

import sys
from typing import TYPE_CHECKING

import typer

from leactl.errors import Stopped

if TYPE_CHECKING:
    from leactl.runfile.importing.proposal.proposal import OpenQuestion, Proposal
    from leactl.runfile.importing.proposal.survey import Survey


def is_attended() -> bool:
    """Whether stdin and stderr are a terminal, so that a user can answer."""
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def ask_open_questions(survey: "Survey") -> "Proposal":
    """Return the proposal with every question answered; earlier answers may settle later questions.

    Raises
    ------
    Stopped : the user ends the input.
    """
    from leactl.runfile.importing.proposal.proposal import propose

    answers: dict[tuple[str, ...], str] = {}
    proposal = propose(survey, answers)
    typer.echo(proposal.text, err=True)
    while proposal.questions:
        question = proposal.questions[0]
        answers[question.key] = ask_question(question)
        proposal = propose(survey, answers)
    if answers:
        typer.echo(proposal.text, err=True)  # with what follows from the answers
    return proposal


def ask_question(question: "OpenQuestion") -> str:
    """Return an accepted answer to a question, asking until one is given."""
    from leactl.runfile.importing.proposal.channel_units import LEAVE_OUT
    from leactl.runfile.importing.proposal.proposal import accepted_answer

    typer.echo(question.text, err=True)
    for number, choice in enumerate(question.choices, start=1):
        typer.echo(f"  {number}  {choice}", err=True)
    leaves_out = f", {LEAVE_OUT} leaves it out" if question.may_be_left_out else ""
    expected = f"1 to {len(question.choices)}, or in words" if question.choices else "a number"
    while True:
        typer.echo(f"{expected}{leaves_out}: ", err=True, nl=False)
        line = sys.stdin.readline()
        if not line:
            raise Stopped("no answer; nothing is imported")
        given = accepted_answer(question, line)
        if given is not None:
            return given
        typer.echo(f"{line.strip()!r} is no answer", err=True)
