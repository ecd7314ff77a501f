"""A study's trials for other tools: CSV, JSON, Parquet, an Optuna database, TensorBoard's event files."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from services.curves import metric_of, metrics_of
from services.errors import BadInput, NotInstalled
from services.listings import artifacts_by_trial, study_json, trial_json
from services.report import behaviour_of, spec_of
from services.spec import ResolvedSpec
from services.store.port import Store, StudyRow, TrialRow
from services.translate import search_space
from services.version import halma_version


class Format(StrEnum):
    """What a study can be exported to."""

    CSV = "csv"
    JSON = "json"
    PARQUET = "parquet"
    OPTUNA = "optuna"
    TENSORBOARD = "tensorboard"


SUFFIXES: Mapping[Format, str] = {
    Format.CSV: ".csv",
    Format.JSON: ".json",
    Format.PARQUET: ".parquet",
    Format.OPTUNA: ".optuna.db",
    Format.TENSORBOARD: ".tensorboard",
}


def columns(row: StudyRow, trials: Sequence[TrialRow]) -> list[dict[str, Any]]:
    """Trials as flat rows: `param_...`, `feature_...` and `detail_...` columns, the same for each."""
    behaviour = behaviour_of(row)
    features = list(behaviour.names) if behaviour else []
    params = sorted({name for trial in trials for name in trial.params})
    details = sorted({name for trial in trials for name, value in trial.details.items() if _plain(value)})
    return [
        {
            "number": trial.number,
            "state": trial.state.value,
            "stage": trial.stage,
            **{f"param_{name}": trial.params.get(name) for name in params},
            "z": trial.z,
            "value": trial.value,
            **{f"feature_{name}": value for name, value in _named(features, trial.features)},
            "samples": trial.samples,
            "seconds": trial.seconds,
            "attempts": trial.attempts,
            "warm_start": trial.warm_start,
            "seed": trial.seed,
            "position": trial.position,
            "message": trial.message,
            **{f"detail_{name}": _plain_or_none(trial.details.get(name)) for name in details},
        }
        for trial in trials
    ]


def write(store: Store, row: StudyRow, form: Format, path: Path) -> int:
    """Export a study.

    Args:
        store: the trial database.
        row: the study.
        form: what to write.
        path: where to; its folder must exist. TensorBoard's is a folder, an Optuna database a new file.

    Returns:
        How many trials were written.

    Raises:
        BadInput: nothing can be written there; then nothing is left there.
        NotInstalled: the format needs a package that isn't.
    """
    if not path.parent.is_dir():
        raise BadInput(f"--output: expected a file in an existing folder, found no folder {path.parent}")
    if form is Format.TENSORBOARD:
        return _write_tensorboard(store, row, path)
    if path.is_dir():
        raise BadInput(f"--output: expected a file, found the folder {path}")
    if form is Format.OPTUNA:
        return _write_optuna(store, row, path)
    trials = store.trials(row.id)
    with _whole(path) as fresh:
        if form is Format.CSV:
            fresh.write_text(csv_text(columns(row, trials)), encoding="utf-8")
        elif form is Format.JSON:
            left = artifacts_by_trial(store.study_artifacts(row.id))
            listed = [trial_json(trial, left.get(trial.id, ())) for trial in trials]
            whole = {"study": study_json(row, spec=True), "trials": listed}
            fresh.write_text(json.dumps(whole, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
        else:
            _write_parquet(columns(row, trials), fresh)
    return len(trials)


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as CSV with a head; nothing is an empty cell."""
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return text.getvalue()


def _write_parquet(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    import pyarrow as pa  # noqa: PLC0415 - half a second that other formats needn't pay
    import pyarrow.parquet as pq  # noqa: PLC0415 - as above

    # What pyarrow can't guess: seeds are unsigned, and a column without any value has a type all the same.
    types = {"seed": pa.uint64(), "z": pa.float64(), "value": pa.float64(), "warm_start": pa.int64()}
    arrays = {
        name: pa.array(
            [row[name] for row in rows], type=pa.float64() if name.startswith("feature_") else types.get(name)
        )
        for name in (rows[0] if rows else {})
    }
    pq.write_table(pa.table(arrays), path)


def _write_optuna(store: Store, row: StudyRow, path: Path) -> int:
    from search.optuna_export import ExportRefused, Trial, export  # noqa: PLC0415 - half a second, as above

    spec = spec_of(row)
    if not isinstance(spec, ResolvedSpec):
        raise BadInput(f"export: expected a study with a space, found that {row.name} has none")
    if path.exists():
        raise BadInput(f"--output: expected a new file for the Optuna database, found {path}, which exists")
    every = store.trials(row.id)
    curves = {trial.number: store.metrics(trial.id) if trial.iteration else [] for trial in every}
    metric = metric_of(metrics_of(each for rows in curves.values() for each in rows))
    trials = [
        Trial(
            params=trial.params,
            status=trial.state.value,
            value=trial.value,
            started=trial.started_at,
            finished=trial.finished_at,
            attributes=_attributes(trial),
            intermediate={each.iteration: each.values[metric] for each in curves[trial.number] if metric in each.values}
            if metric is not None
            else {},
        )
        for trial in every
    ]
    about = {
        "task": row.spec.get("task"), "strategy": row.spec.get("search"), "seed": str(row.seed),
        "intermediate_values": metric, "exported_by": f"halma {halma_version()}",
    }  # fmt: skip
    try:
        with _whole(path) as fresh:
            number = export(row.name, search_space(spec), trials, f"sqlite:///{fresh}", about)
    except ExportRefused as error:
        raise BadInput(f"--output: {error}") from None
    return number


def _attributes(trial: TrialRow) -> dict[str, Any]:
    """What Optuna has no word for, where there is any: each costs it a millisecond.

    A seed is text: it has more digits than a page's numbers hold.
    """
    known = {
        "number": trial.number,
        "stage": trial.stage,
        "features": None if trial.features is None else list(trial.features),
        "z": trial.z,
        "samples": trial.samples,
        "seconds": trial.seconds,
        "attempts": trial.attempts,
        "warm_start": trial.warm_start,
        "seed": str(trial.seed),
        "message": trial.message,
        **{f"detail_{name}": value for name, value in trial.details.items() if _plain(value)},
    }
    return {name: value for name, value in known.items() if value is not None and value != ""}


def _write_tensorboard(store: Store, row: StudyRow, path: Path) -> int:
    if find_spec("tensorboardX") is None:
        raise NotInstalled(
            "export: expected tensorboardX, found that it isn't installed; "
            "install it with `pip install 'halma[tensorboard]'`"
        )
    from services.tensorboard import write_events  # noqa: PLC0415 - an extra

    # TensorBoard would show old runs among the new ones.
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise BadInput(f"--output: expected a new or empty folder for event files, found {path}, which is neither")
    with _whole(path) as fresh:
        fresh.mkdir()
        return write_events(store.trials(row.id), lambda trial: store.metrics(trial.id), behaviour_of(row), fresh)


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """A place beside `path` to write to, moved there at the end: whoever finds the file finds all of it, or none.

    Raises:
        BadInput: it can't be written.
    """
    fresh = path.with_name(f".{path.name}.new")
    try:
        _remove(fresh)
        yield fresh
        fresh.replace(path)
    except OSError as error:
        raise BadInput(
            f"--output: expected a place that can be written, found {path}: {error.strerror or error}"
        ) from None
    finally:
        _remove(fresh)


def _remove(path: Path) -> None:
    """Remove what an interrupted export has left."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _named(names: Sequence[str], features: Sequence[float] | None) -> list[tuple[str, float | None]]:
    values: Sequence[float | None] = features if features is not None else [None] * len(names)
    return list(zip(names, values, strict=False))


def _plain(value: Any) -> bool:
    return value is None or isinstance(value, int | float | str)


def _plain_or_none(value: Any) -> Any:
    return value if _plain(value) else None
