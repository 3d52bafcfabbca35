"""Ask the user the open questions of a proposed mapping by stderr and stdin; stdout is for output alone."""

import sys
from typing import TYPE_CHECKING

import typer

from leactl.errors import Stopped

if TYPE_CHECKING:
    from leactl.runfile.importing.proposal.proposal import OpenQuestion, Proposal
    from leactl.runfile.importing.proposal.survey import Survey


def is_attended() -> bool:
    """Return whether stdin and stderr are a terminal, so that a user can answer."""
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def ask_open_questions(survey: "Survey") -> "Proposal":
    """Ask the open questions of a proposal one by one, and return the proposal with all of them answered.

    An answer may settle later questions, which are then not asked.

    Raises
    ------
    Stopped : the user ends the input before the last answer.
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
        typer.echo(proposal.text, err=True)  # the answers may have changed it
    return proposal


def ask_question(question: "OpenQuestion") -> str:
    """Ask a question until the user gives an acceptable answer, and return it.

    Raises
    ------
    Stopped : the user ends the input.
    """
    from leactl.runfile.importing.proposal.channel_units import LEAVE_OUT
    from leactl.runfile.importing.proposal.proposal import accepted_answer

    typer.echo(question.text, err=True)
    for number, choice in enumerate(question.choices, start=1):
        typer.echo(f"  {number}  {choice}", err=True)
    leave_out_hint = f", {LEAVE_OUT} leaves it out" if question.may_be_left_out else ""
    accepted_text = f"1 to {len(question.choices)}, or in words" if question.choices else "a number"
    while True:
        typer.echo(f"{accepted_text}{leave_out_hint}: ", err=True, nl=False)
        line = sys.stdin.readline()
        if not line:
            raise Stopped("no answer; nothing is imported")
        answer = accepted_answer(question, line)
        if answer is not None:
            return answer
        typer.echo(f"{line.strip()!r} is no answer", err=True)
