"""`wbmpc new`: from a model to a robot's YAML, with proposals and at most six questions."""

from __future__ import annotations

import functools
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wbmpc.cli.directories import AsJson, Force, new_file
from wbmpc.cli.doctor import Arguments, Packages, collisions, pairs
from wbmpc.errors import InputError, printable, shell_command

if TYPE_CHECKING:
    from wbmpc.bases.base import Question
    from wbmpc.model.robot import RobotModel
    from wbmpc.robots.draft import Draft
    from wbmpc.robots.home import Home

#: Height [m] of an end effector above the ground that is taken for a mistake.
_HIGHEST = 20.0


def new(
    model: Annotated[Path, typer.Argument(help="A URDF, xacro or MJCF.")],
    out: Annotated[
        Path | None, typer.Option(help="The YAML to write (default: named after the model, in this directory).")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Accept all proposals without questions.")] = False,
    base: Annotated[str | None, typer.Option(help="Base type.")] = None,
    arm: Annotated[
        str | None, typer.Option(help="Name of the arm or of its last joint; several separated by commas: left,right.")
    ] = None,
    tool: Annotated[str | None, typer.Option(help="Frame of the end effector.")] = None,
    height: Annotated[
        float | None, typer.Option(help="Height (m) of the end effector above the ground at home.")
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="A key of the YAML, e.g. base.wheel_radius=0.1; may be repeated."
        ),
    ] = None,
    package: Packages = None,
    argument: Arguments = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Describe a robot: find wheels, arm and tool of a model, propose base type, home and limits, write a YAML."""
    from wbmpc.robots.draft import description_of, make_draft
    from wbmpc.robots.mechanism import read_mechanism
    from wbmpc.robots.model_file import read_model

    if not model.is_file():
        raise InputError(f"{model}: there is no such file; a URDF, xacro or MJCF is needed")
    if model.suffix in (".yaml", ".yml"):
        check = shell_command("wbmpc", "doctor", model)
        raise InputError(f"{model}: a URDF, xacro or MJCF is needed; a robot file is checked by: {check}")
    path = new_file("--out", out, Path(f"{model.name.split('.')[0]}.yaml"), force)
    packages = {name: Path(folder) for name, folder in pairs("--package", package).items()}
    arguments, keys = pairs("--argument", argument), dict(_assigned(assignments))
    draft = make_draft(read_mechanism(read_model(model, packages, arguments)))
    ask = not yes and not as_json and sys.stdin.isatty()
    _choose(draft, base, arm, tool, keys, ask)
    if ask and height is None and draft.subject.driven:
        height = _ask("height of the end effector above the ground at home [m]", _usual_height(), _height)
    elif height is not None:
        height = _height(str(height), "--height")
    data, home = description_of(draft, path, packages, arguments, height)
    for key, value in keys.items():
        _assign(data, key, value)
    robot = _write(path, data, draft, home, follow=out is not None)
    if as_json:
        typer.echo(json.dumps({"robot": str(path), "description": data}))
    else:
        for line in _summary(path, draft, home, robot, data):
            typer.echo(printable(line))


# ---------------------------------------------------------------------- choices
def _usual_height() -> float:
    from wbmpc.robots.draft import WORKING_HEIGHT

    return WORKING_HEIGHT


def _choose(
    draft: Draft, base: str | None, arm: str | None, tool: str | None, keys: Mapping[str, Any], ask: bool
) -> None:
    """Base, its own questions, arm and tool: by options, else by questions, else as proposed."""
    if base is None and ask and len(draft.bases) > 1:
        for name, proposal in draft.bases.items():
            typer.echo(f"  {name}: {proposal.reason}")
        _ask("base type", draft.base, draft.choose_base)
    elif base is not None:
        draft.choose_base(base)
    for question in draft.proposal.questions:
        given = keys.get(f"base.{question.key}")
        if given is not None:
            with suppress(InputError):  # the robot's loader says what is wrong with it
                draft.answer(question.key, _answer(draft, question, str(given)))
        elif ask:
            value = _ask(question.text, question.answer, functools.partial(_answer, draft, question))
            draft.answer(question.key, value)
    if arm is None and ask and len(draft.arms) > 1:
        for found in draft.arms:
            typer.echo(f"  {found.name}: {len(found.joints)} joints, {found.length:.2f} m")
        _ask("arm (several with commas between them)", draft.arm.name, draft.choose_arm)
    elif arm is not None:
        draft.choose_arm(arm)
    if tool is None and ask and len(draft.arm.tools) > 1:
        _ask(f"frame of the end effector ({', '.join(draft.arm.tools[:8])})", draft.tool, draft.choose_tool)
    elif tool is not None:
        draft.choose_tool(tool)


def _ask(text: str, default: Any, accept: Callable[[str], Any]) -> Any:
    """What ``accept`` makes of an answer; one that it rejects is asked for again, with its reason."""

    def value(given: str) -> Any:
        try:
            return accept(given)
        except InputError as error:
            raise typer.BadParameter(printable(str(error))) from error

    return typer.prompt(text, default=str(default), value_proc=value)


def _answer(draft: Draft, question: Question, text: str) -> Any:
    """The value of a key of the base type's section, as the type declares it."""
    from pydantic import TypeAdapter, ValidationError

    from wbmpc.bases import base_type

    value = _value(question.text, text)
    field = base_type(draft.base).Description.model_fields[question.key]
    declared: Any = Annotated[field.annotation, field]
    try:
        TypeAdapter(declared).validate_python(value)
    except ValidationError as error:
        raise InputError(f"{question.text}: {error.errors()[0]['msg']}, got '{text}'") from error
    return value


def _height(text: str, what: str = "height") -> float:
    from wbmpc.checks import parse_number

    try:
        value = parse_number(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= _HIGHEST:
        raise InputError(f"{what}: a number from -{_HIGHEST:g} to {_HIGHEST:g} m is needed, got '{text}'")
    return value


def _assigned(given: list[str] | None) -> Iterator[tuple[str, Any]]:
    for text in given or []:
        key, sign, value = text.partition("=")
        if not sign or not key:
            raise InputError(f"--set: KEY=VALUE is needed, got '{text}'")
        yield key, _value("--set", value)


def _value(what: str, text: str) -> Any:
    from wbmpc.yaml_file import parse_yaml

    return parse_yaml(text, what)


def _assign(data: dict[str, Any], key: str, value: Any) -> None:
    """Set a dotted key; what is wrong with it the robot's loader says."""
    *above, last = key.split(".")
    for part in above:
        inner = data.setdefault(part, {})
        if not isinstance(inner, dict):
            raise InputError(f"--set: key '{key}': '{part}' has no keys inside")
        data = inner
    data[last] = value


# ---------------------------------------------------------------------- writing
def _write(path: Path, data: dict[str, Any], draft: Draft, home: Home, follow: bool) -> RobotModel:
    """Write the YAML if the robot loads with it; then its weights are known too. ``follow``: as of :func:`whole_file`."""
    from wbmpc.model.robot import load_robot
    from wbmpc.output_file import whole_file
    from wbmpc.robots.description import load_description
    from wbmpc.robots.robot_yaml import write_yaml

    comments = _comments(draft, home)
    with whole_file(path, follow) as partial:  # what was there before stays until the robot loads
        try:
            partial.write_text(write_yaml(data, comments), encoding="utf-8")
            robot = load_robot(partial)
            comments["limits"] += "\n" + _weights(robot)
            _list_pairs(data, comments, robot)
            partial.write_text(write_yaml(data, comments), encoding="utf-8")
            load_description(partial)  # with names of bodies that were not in it
        except InputError as error:
            raise InputError(str(error).replace(str(partial), str(path))) from error
    return robot


def _list_pairs(data: dict[str, Any], comments: dict[str, str], robot: RobotModel) -> None:
    """The bodies that can run into each other, for a person to confirm: unless they are given, or the model has no shapes."""
    from wbmpc.obstacles.pairs import list_pairs

    if "collision" in data:
        return
    try:
        found = list_pairs(robot)
    except InputError:  # without shapes, or with meshes that are missing
        return
    if not found.pairs and not found.drawn:
        return
    text = f"bodies that come near each other in {found.samples} random states, which plans keep apart: confirm them"
    for name, left in (
        ("near only where one of these is, left out", found.rare),
        ("touching at home, left out", found.close),
    ):
        text += f"\n{name}: {', '.join('-'.join(p) for p in left)}" if left else ""
    if found.missed:
        text += f"\nof random states in which bodies are near each other, {found.missed:.1%} have no pair of these"
    text += "\nignore: their shapes overlap in most states, and may in the simulation" if found.drawn else ""
    comments["collision"], comments["collision.self"] = text, ""
    ignored = {"ignore": [list(p) for p in found.drawn]} if found.drawn else {}
    data["collision"] = {"self": {"pairs": [list(p) for p in found.pairs], **ignored}}


def _comments(draft: Draft, home: Home) -> dict[str, str]:
    from wbmpc.robots.draft import ground_of, limits_of

    x, _, z = home.tool
    z -= ground_of(draft)
    assumed = limits_of(draft)[1]
    free = {True: ", no collision of the file's shapes", False: ", ITS SHAPES TOUCH: choose another", None: ""}[
        home.free
    ]
    speeds = "as the model has them" + (f"; assumed: {', '.join(assumed)}" if assumed else "")
    others = [a.name for a in draft.arms if a not in draft.chosen]
    key = "arms" if draft.beside else "arm"
    return {
        "": f"Written by wbmpc new from {draft.mechanism.file.path.name}. Units: SI and radians. Check it with: wbmpc doctor FILE",
        "base": f"{draft.base}: {draft.proposal.reason}"
        + "".join(f"\nassumed: {q.key}: {q.answer} ({q.text})" for q in draft.unanswered),
        key: "; ".join(
            f"{a.name + ': ' if draft.beside else ''}{a.length:.2f} m along {len(a.joints)} joints"
            for a in draft.chosen
        )
        + (f"; others: {', '.join(others)}" if others else ""),
        "couple": "joints that follow others, as the model says (mimic)",
        "fixed_joints": "joints that neither base nor arm moves",
        "home": f"best of random postures: end effector at x = {x:.2f} m, {z:.2f} m above the floor{free}",
        "limits": "What is not here is as the model has it (ranges, efforts).",
        "limits.velocity": f"[rad/s, m/s] {speeds}",
        "limits.acceleration": "[rad/s², m/s²] assumed: wheels do not slip, an arm is at its speed in 1/3 s, the robot does not tip over",
    }


def _weights(robot: RobotModel) -> str:
    """The default weights, for one's own problems."""
    from wbmpc.ocp.scaling import reach, scaled_weights

    weights = scaled_weights(robot)
    posture = ", ".join(f"{w:.3g}" for w in weights.posture)
    inputs = "; ".join(f"{g}: {', '.join(f'{w:.3g}' for w in row)}" for g, row in weights.input.items())
    return (
        f"Weights that follow (wbmpc.ocp.scaling, reach {reach(robot):.2f} m): end effector {weights.end_effector[0]:g} /m², "
        f"orientation {weights.end_effector[3]:.3g} /rad²,\nposture {posture},\ninputs {inputs}"
    )


def _summary(path: Path, draft: Draft, home: Home, robot: RobotModel, data: Mapping[str, Any]) -> Iterator[str]:
    from wbmpc.bases import offers
    from wbmpc.robots.doctor import examine_robot
    from wbmpc.robots.draft import ground_of

    yield f"{path}: {robot.description.name}, {robot.state.size} states"
    yield f"  base: {draft.base} ({draft.proposal.reason})"
    for question in draft.unanswered:
        yield f"  assumed: {question.text}: {question.answer}; to change it: --set base.{question.key}=VALUE"
    for arm in draft.chosen:
        yield f"  arm{f' {arm.name}' if draft.beside else ''}: {', '.join(arm.joints)}"
    others = [a.name for a in draft.arms if a not in draft.chosen and len(a.joints) >= len(draft.arm.joints) // 2]
    if others:
        yield (
            f"  other arms: {', '.join(others)}; to use them: "
            + shell_command("--arm", ",".join([*(a.name for a in draft.chosen), *others]))
        )
    yield f"  end effector: {draft.tool}, at home {home.tool[2] - ground_of(draft):.2f} m high" + (
        "" if home.free is not False else "; shapes touch there"
    )
    pairs = data.get("collision", {}).get("self", {}).get("pairs", ())
    yield f"  self-collision: {len(pairs)} pairs of bodies are kept apart" + (
        "" if pairs else " (wbmpc doctor says which shapes it has)"
    )
    yield f"  fixed joints: {', '.join(robot.description.fixed_joints) or 'none'}"
    if draft.subject.driven and not robot.description.base.moves:
        check = shell_command("wbmpc", "doctor", draft.mechanism.file.path)
        yield f"  note: its wheels stand still; why no base type drives them: {check}"
    found = examine_robot(str(path))
    warnings = found.count("warning") + sum(f.severity == "warning" for f in collisions(str(path)))
    yield f"  {shell_command('wbmpc', 'doctor', path)}: {found.count('error')} errors, {warnings} warnings"
    shown = offers(draft.base, "system")
    yield f"  next: {shell_command('wbmpc', 'view', path)}" if shown else f"  next: wb.load_robot({str(path)!r})"
