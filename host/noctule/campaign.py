"""`noctule campaign FILE`: worlds x seeds x policies x parameter values, flown in-process on all cores, and compared.

Every flight is a process of its own that leaves its run directory, so one that breaks or is killed ends nothing and a
campaign that was stopped, by whatever means, goes on where it was. With --scheduler the same flights run on a cluster
through Dask distributed, and only the reports come back. Page: docs/campaign.md.
"""

from __future__ import annotations

import ctypes
import hashlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from noctule import record
from noctule.processes import PR_SET_PDEATHSIG
from noctule.settings import DEFAULT_MAX_TIME_S, POLICIES, PRESETS, PROFILES, FlightSettings, InputError, parameter_row, policy_choice

FOLDER = Path("runs") / "campaign"
TRIES = 2                    # a flight whose process dies is flown once more: it may have been killed from outside
KEYS = {"name", "worlds", "seeds", "policies", "parameters", "preset", "profile", "max_time_s"}


@dataclass(frozen=True)
class Trial:
    """One flight of a campaign. values: (name, value) of each parameter that the campaign varies or sets."""

    world: str
    seed: int
    policy: str
    values: tuple[tuple[str, float], ...] = ()

    @property
    def label(self) -> str:
        """Folder name; unique in a campaign."""
        readable = f"{Path(self.world).stem}-{self.seed}-{self.policy.replace(':', '.')}"
        return readable if not self.values else readable + "-" + "-".join(f"{name}={value:g}" for name, value in self.values)

    @property
    def variant(self) -> str:
        """What is compared: policy and parameter values, without world and seed."""
        return " ".join([self.policy, *(f"{name}={value:g}" for name, value in self.values)])


@dataclass
class Campaign:
    """A campaign file. base: folder that relative paths of worlds are looked up from."""

    name: str
    worlds: list[str]
    seeds: list[int]
    policies: list[str] = field(default_factory=lambda: [POLICIES[0]])
    parameters: dict[str, list[float]] = field(default_factory=dict)
    preset: str = "default"
    profile: str = "default"
    max_time_s: float = DEFAULT_MAX_TIME_S

    def trials(self) -> Iterator[Trial]:
        """Every flight; seeds vary slowest, so that a campaign that was stopped half way has all worlds and variants."""
        grids = [[(name, value) for value in values] for name, values in self.parameters.items()]
        for seed, world in itertools.product(self.seeds, self.worlds):
            for policy, *values in itertools.product(self.policies, *grids):
                yield Trial(world, seed, policy, tuple(values))

    def settings(self, trial: Trial, out: Path) -> FlightSettings:
        """What the flight is asked to be."""
        policy, policy_class = policy_choice(trial.policy)
        return FlightSettings(world=trial.world, seed=trial.seed, out=out, camera=False, max_time_s=self.max_time_s, preset=self.preset,
                              profile=self.profile, parameters={**dict(trial.values), "policy": policy}, policy_class=policy_class)


def _numbers(name: str, values, kind) -> list:
    values = values if isinstance(values, list) else [values]
    if not values or not all(isinstance(v, (int, float)) and not isinstance(v, bool) and v == kind(v) for v in values):
        raise InputError(f"{name}: a list of {'whole ' if kind is int else ''}numbers is wanted")
    return [kind(v) for v in values]


def read(path: Path) -> Campaign:
    """Reads and checks a campaign file (TOML).

    Raises:
        InputError: it cannot be read, or asks for something that does not exist; one line says what.
    """
    from noctule_sim.world import WorldError, load_world

    try:
        told = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise InputError(f"{path}: not TOML: {error}") from None
    unknown = sorted(set(told) - KEYS)
    if unknown:
        raise InputError(f"{path}: no such entry '{unknown[0]}'; there are {', '.join(sorted(KEYS))}")
    missing = sorted({"worlds", "seeds"} - set(told))
    if missing:
        raise InputError(f"{path}: '{missing[0]}' is missing")
    try:
        worlds = []
        for name in told["worlds"]:
            beside = path.parent / str(name)
            worlds.append(str(beside.resolve()) if beside.is_file() else str(name))
            load_world(worlds[-1])
        parameters = {}
        for name, values in told.get("parameters", {}).items():
            row = parameter_row(name)
            parameters[row.name] = _numbers(name, values, int if row.type == "int" else float)
            for value in parameters[row.name]:
                if not row.min <= value <= row.max:
                    raise InputError(f"{name}: {value:g} is outside {row.min:g} to {row.max:g}")
        policies = [str(p) for p in told.get("policies", POLICIES[:1])]
        for policy in policies:
            policy_choice(policy)
        campaign = Campaign(str(told.get("name", path.stem)), worlds, _numbers("seeds", told["seeds"], int), policies, parameters,
                            str(told.get("preset", "default")), str(told.get("profile", "default")),
                            float(told.get("max_time_s", DEFAULT_MAX_TIME_S)))
    except (InputError, WorldError) as error:
        raise InputError(f"{path}: {error}") from None
    if campaign.preset not in PRESETS or campaign.profile not in PROFILES:
        raise InputError(f"{path}: preset is one of {', '.join(PRESETS)}; profile is one of {', '.join(PROFILES)}")
    labels = [trial.label for trial in campaign.trials()]
    if len(set(labels)) != len(labels):
        raise InputError(f"{path}: a flight is asked for twice")
    return campaign


def fly_trial(settings: FlightSettings, folder: Path) -> dict:
    """Flies one flight in this process; its report."""
    from noctule import inprocess_flight
    from noctule_sim.world import load_world

    return inprocess_flight.fly(settings, load_world(settings.world), folder)


@lru_cache(maxsize=None)
def policy_source(policy: str) -> str:
    """A fingerprint of a Python policy's module and of what it sees the map through; "" for one of the firmware."""
    if ":" not in policy:
        return ""
    from noctule import policy as view
    from noctule import policy_host

    digest = hashlib.sha256()
    for module in (sys.modules[policy_host.load(policy).__module__], view, policy_host):
        digest.update(Path(module.__file__).read_bytes())
    return "@" + digest.hexdigest()[:16]


def _key(campaign: Campaign, trial: Trial, programs: str) -> dict:
    """What a kept flight must have been flown with to be kept."""
    world = Path(trial.world)
    content = hashlib.sha256(world.read_bytes()).hexdigest()[:16] if world.is_file() else trial.world
    return {"programs": programs, "world": content, "seed": trial.seed, "policy": trial.policy + policy_source(trial.policy), "values": dict(trial.values),
            "preset": campaign.preset, "profile": campaign.profile, "max_time_s": campaign.max_time_s}


def kept(folder: Path, key: dict) -> dict | None:
    """The report of a flight that was flown to its end with that key, or None."""
    return record.read_json(folder / "report.json") if record.read_json(folder / "trial.json") == key else None


def _die_with_parent() -> None:
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def _start(folder: Path, campaign: Campaign, trial: Trial) -> subprocess.Popen:
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    asked = {"campaign": {**vars(campaign)}, "trial": {"world": trial.world, "seed": trial.seed, "policy": trial.policy,
                                                       "values": [list(v) for v in trial.values]}}
    (folder / "asked.json").write_text(json.dumps(asked) + "\n", encoding="utf-8")
    with (folder / "flight.txt").open("w", encoding="utf-8") as words:
        return subprocess.Popen([sys.executable, "-m", "noctule.campaign", str(folder)], stdin=subprocess.DEVNULL, stdout=words,
                                stderr=subprocess.STDOUT, preexec_fn=_die_with_parent,
                                env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})


def _finish(folder: Path, key: dict) -> dict:
    """Marks a flight as flown to its end: trial.json comes last and whole."""
    part = folder / "trial.part"
    part.write_text(json.dumps(key) + "\n", encoding="utf-8")
    os.replace(part, folder / "trial.json")
    return record.read_json(folder / "report.json")


def broken(trial: Trial, folder: Path, code: int) -> dict:
    """What stands for the report of a flight whose process ended without one."""
    words = (folder / "flight.txt").read_text(encoding="utf-8", errors="replace").strip().splitlines() if (folder / "flight.txt").exists() else []
    return {"outcome": "broken", "why": f"exit code {code}" + (f": {words[-1]}" if words else ""), "world": trial.world, "seed": trial.seed}


def run_local(campaign: Campaign, folder: Path, programs: str, workers: int, say: Callable[[str], None]) -> dict[Trial, dict]:
    """Flies what is not kept, so many flights at a time; reports of all trials."""
    reports: dict[Trial, dict] = {}
    waiting = []
    for trial in campaign.trials():
        old = kept(folder / trial.label, _key(campaign, trial, programs))
        if old:
            reports[trial] = old
        else:
            waiting.append((trial, 1))
    if reports:
        say(f"{len(reports)} flights kept, {len(waiting)} to fly")
    flying: list[tuple[Trial, int, subprocess.Popen]] = []
    try:
        while waiting or flying:
            while waiting and len(flying) < workers:
                trial, attempt = waiting.pop(0)
                flying.append((trial, attempt, _start(folder / trial.label, campaign, trial)))
            time.sleep(0.05)
            for entry in [f for f in flying if f[2].poll() is not None]:
                trial, attempt, process = entry
                flying.remove(entry)
                here = folder / trial.label
                if process.returncode == 0 and record.read_json(here / "report.json"):
                    reports[trial] = _finish(here, _key(campaign, trial, programs))
                elif attempt < TRIES:
                    waiting.append((trial, attempt + 1))
                    continue
                else:
                    reports[trial] = broken(trial, here, process.returncode)
                say(f"{len(reports)} {trial.label}: {reports[trial]['outcome']}"
                    + (f" ({reports[trial]['why']})" if reports[trial]["outcome"] == "broken" else ""))
    finally:
        for _, _, process in flying:
            process.kill()
            process.wait()
    return reports


def fly_remote(settings: FlightSettings) -> dict:
    """One flight on a worker of a cluster, in a folder that it leaves nothing in; its report and its true path."""
    import tempfile

    with tempfile.TemporaryDirectory(prefix="noctule-") as name:
        folder = Path(name) / "run"
        report = fly_trial(settings, folder)
        return {"report": report, "truth": (folder / "truth.csv").read_bytes(), "world": (folder / "world.yaml").read_bytes()}


def run_dask(campaign: Campaign, folder: Path, programs: str, address: str, say: Callable[[str], None]) -> dict[Trial, dict]:
    """As run_local, the flights submitted to a Dask scheduler. Workers need the same build of Noctule.

    Raises:
        InputError: Dask is not installed, or no scheduler answers there.
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise InputError("--scheduler needs Dask: pip install distributed") from None
    reports: dict[Trial, dict] = {}
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {address}: no Dask scheduler answers there ({error})") from None
    with client:
        futures = {}
        for trial in campaign.trials():
            key = _key(campaign, trial, programs)
            old = kept(folder / trial.label, key)
            if old:
                reports[trial] = old
            else:
                # One flight a worker thread at a time; a worker that dies takes its flight with it, which is then tried once more.
                futures[client.submit(fly_remote, campaign.settings(trial, Path("run")), retries=TRIES - 1, pure=False)] = (trial, key)
        if reports:
            say(f"{len(reports)} flights kept, {len(futures)} to fly")
        for future in as_completed(futures):
            trial, key = futures[future]
            here = folder / trial.label
            if here.exists():
                shutil.rmtree(here)
            here.mkdir(parents=True)
            if future.status == "finished":
                told = future.result()
                (here / "truth.csv").write_bytes(told["truth"])
                (here / "world.yaml").write_bytes(told["world"])
                (here / "report.json").write_text(json.dumps(told["report"], indent=2) + "\n", encoding="utf-8")
                reports[trial] = _finish(here, key)
            else:
                reports[trial] = {"outcome": "broken", "why": repr(future.exception()), "world": trial.world, "seed": trial.seed}
            say(f"{len(reports)} {trial.label}: {reports[trial]['outcome']}")
    return reports


def programs() -> str:
    """A fingerprint of what a flight in-process is made by: the firmware's library and the simulator."""
    import noctule_sim
    from noctule.inprocess import library_path

    digest = hashlib.sha256(Path(library_path()).read_bytes())
    for path in sorted(Path(noctule_sim.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def run(path: Path, out: Path | None = None, workers: int | None = None, scheduler: str | None = None) -> tuple[Campaign, dict[Trial, dict], Path]:
    """Flies a campaign and writes its tables and pictures.

    Args:
        path: campaign file.
        out: folder of its runs; None: runs/campaign/<name>.
        workers: flights at a time; None: one a core.
        scheduler: address of a Dask scheduler; None: this machine.

    Returns:
        the campaign, the report of every trial, the folder.

    Raises:
        InputError: bad input, in one line.
    """
    from noctule import campaign_table

    campaign = read(path)
    folder = out or FOLDER / campaign.name
    folder.mkdir(parents=True, exist_ok=True)

    def say(text: str) -> None:
        print(text, flush=True)

    begin = time.monotonic()
    if scheduler:
        reports = run_dask(campaign, folder, programs(), scheduler, say)
    else:
        reports = run_local(campaign, folder, programs(), workers or os.cpu_count() or 1, say)
    say(f"{len(reports)} flights, {time.monotonic() - begin:.0f} s")
    ordered = {trial: reports[trial] for trial in campaign.trials()}
    campaign_table.write(folder, ordered)
    return campaign, ordered, folder


def _child(folder: Path) -> int:
    """One flight, as asked.json in its folder says; a process of its own."""
    asked = record.read_json(folder / "asked.json")
    campaign = Campaign(**asked["campaign"])
    told = asked["trial"]
    trial = Trial(told["world"], told["seed"], told["policy"], tuple((name, value) for name, value in told["values"]))
    fly_trial(campaign.settings(trial, folder), folder)
    return 0


if __name__ == "__main__":
    sys.exit(_child(Path(sys.argv[1])))
