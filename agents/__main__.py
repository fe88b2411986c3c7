"""`python -m agents`: what agents do, from the command line."""

from pathlib import Path
from typing import Annotated, NoReturn

import typer

from agents.errors import AgentError
from relloc_env.console import lenient
from relloc_env.extras import MissingExtraError

Options = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="OPTION=VALUE", help="Of the environment, over those of the suite: camera=image"),
]

Trust = Annotated[
    bool, typer.Option("--trust", help="Run code that files name, and read pickled ones: of people you trust alone.")
]

app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, help=__doc__
)


@app.callback()
def _agents() -> None:
    """Ways to move, shown and compared."""


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for tables, figures, the animation and the results.")] = Path(
        "out/demo"
    ),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first of the random scenes.")] = 4,
    log: Annotated[Path | None, typer.Option(help="Recorded log to replay, in place of those at hand.")] = None,
) -> None:
    """Run the paper's experiment, a handful of motions on random scenes, and recorded robots where logs are at hand."""
    try:
        from agents.demo import run
        from relloc_env.logs import LogError
    except MissingExtraError as error:
        _stop(str(error))
    try:
        run(out, seed=seed, log=log)
    except KeyboardInterrupt:
        _stop("Stopped; the same command begins anew", 130)
    except (LogError, MissingExtraError, ValueError, OSError) as error:
        _stop(str(error))


@app.command()
def film(
    out: Annotated[Path, typer.Option(help="The animation, .gif or .mp4.")] = Path("out/film.gif"),
    motion: Annotated[str, typer.Option(help="Name of the agent.")] = "edge-near",
    beside: Annotated[str | None, typer.Option(help="Another agent from the same start, beside it.")] = None,
    titles: Annotated[str, typer.Option(help="What to call them in the picture, parted by commas.")] = "",
    env: Annotated[str, typer.Option(help="Id of the environment.")] = "relloc_env/RelativePose-v0",
    suite: Annotated[str, typer.Option(help="Name of the suite; of several variants, the first.")] = "open-field",
    estimator: Annotated[str, typer.Option(help="Name of the estimator.")] = "map-alignment",
    options: Options = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 4,
    width: Annotated[int, typer.Option(min=320, help="Width of the picture [px].")] = 720,
    faster: Annotated[float, typer.Option(min=0.1, help="Times as fast as the robots.")] = 3.0,
    dark: Annotated[bool, typer.Option("--dark", help="Light on dark.")] = False,
    rerun: Annotated[
        Path | None, typer.Option(help="A file, .rrd, of the first motion for the viewer of Rerun (extra: rerun).")
    ] = None,
    trust: Trust = False,
) -> None:
    """Draw one episode of one agent, or of two from the same start."""
    try:
        from agents.film import film as draw
        from agents.jobs import shown_in
        from agents.registry import agent, refuse_pickled, short
    except MissingExtraError as error:
        _stop(str(error))
    try:
        shown = [motion] if beside is None else [motion, beside]
        if not trust:
            refuse_pickled(shown)
        called = names(titles) or tuple(map(short, shown))
        if len(called) != len(shown):
            _stop(f"Argument `titles` must have one for each of {len(shown)} agents, but has {len(called)}")
        draw(
            out, [shown_in(env, suite, name, estimator, options or ()) for name in shown],
            dict(zip(called, map(agent, shown), strict=True)),
            seed=seed, width=width, faster=faster, theme="dark" if dark else "light", rerun=rerun,
        )  # fmt: skip
    except AgentError as error:
        _stop(str(error), 1)
    except (MissingExtraError, ValueError, OSError) as error:
        _stop(str(error))
    typer.echo(f"Film: {out}")


EVERY = "all"


@app.command()
def benchmark(
    out: Annotated[Path, typer.Option(help="Folder of results; what is there already is not done again.")],
    env: Annotated[str, typer.Option(help="Id of the environment.")] = "relloc_env/RelativePose-v0",
    suite: Annotated[str, typer.Option(help="Names of suites, parted by commas.")] = EVERY,
    agents: Annotated[
        str, typer.Option(help="Names, or path/to/file.py:MyAgent, parted by commas; all: scripted and feedback.")
    ] = EVERY,
    estimators: Annotated[str, typer.Option(help="Names of estimators, parted by commas.")] = "cascade,map-alignment",
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each agent on each suite.")] = 500,
    seeds: Annotated[str, typer.Option(help="Set of seeds: train, validation or test.")] = "test",
    options: Options = None,
    cores: Annotated[int | None, typer.Option(min=1, help="Cores to use; default: all.")] = None,
    trust: Trust = False,
) -> None:
    """Play agents on suites of scenarios and score what they make known. Stopped, it goes on where it was."""
    try:
        from agents.benchmark import benchmark as run
        from agents.jobs import Asked
        from agents.progress import bar
        from agents.registry import AGENTS, refuse_pickled
        from relloc_env.scenarios import SUITES
    except MissingExtraError as error:
        _stop(str(error))
    asked = Asked(
        env=env,
        suites=tuple(SUITES) if suite == EVERY else names(suite),
        agents=tuple(AGENTS) if agents == EVERY else names(agents),
        estimators=names(estimators),
        episodes=episodes,
        seeds=seeds,
        options=tuple(options or ()),
    )
    try:
        if not trust:
            refuse_pickled(asked.agents)
        with bar() as tell:
            run(asked, out, cores=cores, tell=tell)
    except (TypeError, ValueError, OSError) as error:
        _stop(str(error))
    except KeyboardInterrupt:
        _stop("Stopped; the same command goes on")
    for name, which in asked.unfit().items():
        typer.echo(f"Left out, since `{name}` was not made for it: {', '.join(which)}")
    typer.echo(f"Results: {out}. Make the page of them: python -m agents report {out}")


@app.command()
def report(
    out: Annotated[Path, typer.Argument(help="Folder that `benchmark` has filled.", metavar="DIR")],
    animations: Annotated[bool, typer.Option(help="Draw an episode of each agent, some seconds each.")] = True,
    trust: Trust = False,
) -> None:
    """Make the page about a folder of results, report.html in it, and summary.json with every figure of its tables."""
    try:
        from agents.progress import bar
        from agents.report import report as make
    except MissingExtraError as error:
        _stop(str(error))
    amiss: list[str] = []
    try:
        with bar() as tell:
            page = make(out, animations=animations, trust=trust, tell=tell, warn=amiss.append)
    except (MissingExtraError, ValueError, OSError) as error:
        _stop(str(error))
    for line in amiss:
        typer.echo(f"Warning: {line}", err=True)
    typer.echo(f"Page: {page}")


@app.command()
def tables(
    out: Annotated[
        list[Path], typer.Argument(help="Folders that `benchmark` has filled, of one id.", metavar="DIR...")
    ],
    show: Annotated[str, typer.Option(help="Which: told, over, made, ranks, suites; parted by commas.")] = "told",
    over: Annotated[str, typer.Option(help="Agents over which `over` gives the others' paired differences.")] = "",
    agents: Annotated[str, typer.Option(help="Agents to show; all: every one.")] = EVERY,
    suite: Annotated[str, typer.Option(help="Suites to show; all: every one.")] = EVERY,
) -> None:
    """Print tables of results as Markdown, with the commands that made them."""
    try:
        from agents.report.markdown import markdown
    except MissingExtraError as error:
        _stop(str(error))
    try:
        chosen = (() if text == EVERY else names(text) for text in (agents, suite))
        typer.echo(markdown(out, names(show), names(over), *chosen))
    except (MissingExtraError, ValueError, OSError) as error:
        _stop(str(error))


def names(text: str) -> tuple[str, ...]:
    """Names parted by commas, each once."""
    return tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def _stop(message: str, code: int = 2) -> NoReturn:
    """Print one line and end with an exit code."""
    typer.echo(f"Error: {message}", err=True)
    raise typer.Exit(code)


if __name__ == "__main__":
    lenient()
    app()
