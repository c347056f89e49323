# SPDX-License-Identifier: Apache-2.0
"""The touches in a log, read only where they are asked for, and the run whose ball centres follow from them."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from rosette_ros.core.run.errors import InvalidData, counted, plain
from rosette_ros.core.run.geometry import Floats
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.sphere_refit import SphereRefit, TouchedBalls, refit_spheres
from rosette_ros.io.log_reader import decoded, find_files, open_files, read_log
from rosette_ros.io.log_run import LogRun
from rosette_ros.io.messages import MACHINE_FRAME, TOUCH_ARRAYS, Answer, nanoseconds, short_frame
from rosette_ros.io.open_run import is_log
from rosette_ros.io.safe_yaml import BAD_VALUE

TOUCHES = 'rosette_msgs/msg/Touches'
NONE = 'expected touches to fit the spheres again, found none'


def open_refitted(path: str | Path, run_id: str | None = None) -> tuple[Run, SphereRefit]:
    """Return the Run of a log, its ball centres recalculated from its touches, and the fit of the spheres.

    Balls without touches keep the centre that was sent; a note of the run says how many. Raises InvalidData where
    there are no touches, or `open_run` does."""
    if not is_log(path):
        raise InvalidData(f'{path}: {NONE}: a table holds ball centres only; give the log of the run')
    log = read_log(path)
    refit = refit_of(log, run_id)
    answers = log.run(run_id).with_centres(refit.centres)
    run = replace(log, runs={**log.runs, answers.run_id: answers}).to_run(answers.run_id)
    return run.replace(notes=(*run.notes, refit_words(refit))), refit


def refit_if_touched(path: str | Path, run_id: str | None = None) -> SphereRefit | None:
    """Return the spheres fitted to the touches of a run, None where it is a table or its log has none."""
    if not is_log(path):
        return None
    log = read_log(path)
    return refit_of(log, run_id) if any(one.type_name == TOUCHES and one.messages for one in log.topics) else None


def refit_words(refit: SphereRefit) -> str:
    """Return how many ball centres were recalculated, and why others were not."""
    left = '; '.join(f'{count} with {why}' for why, count in refit.touched.left_out.items())
    return (f'{counted(refit.radius.size, "ball centre")} recalculated from {refit.residual.size} touches'
            f'{f", as sent: {left}" * bool(left)}')


def refit_of(log: LogRun, run_id: str | None = None) -> SphereRefit:
    """Return the spheres fitted to the touches of a run; raises InvalidData where none can be."""
    touched = read_touches(log, run_id)
    refit = refit_spheres(touched)
    if not refit.radius.size:
        why = '; '.join(f'{count} with {words}' for words, count in refit.touched.left_out.items())
        raise InvalidData(f'{log.path}: expected touches that determine spheres, found {why}')
    return refit


def read_touches(log: LogRun, run_id: str | None = None) -> TouchedBalls:
    """Return the touches of the readings that count in a run, in all its phases.

    Touches belong to an answer of the same seq, ball, table position and stamp. Raises InvalidData where the log has no
    touches, they cannot be decoded, or no one run is chosen."""
    answers = log.run(run_id)
    counting = {(answer.seq, answer.stamp_ns): answer for _, answer in answers.counting()}
    found, unused = dict[int, tuple[Answer, Floats, SimpleNamespace]](), dict[int, str]()
    for file in open_files(find_files(log.path)):
        for message in file.messages(lambda channel: channel.type_name == TOUCHES):
            where = f'{file.path}: topic {message.topic}: message {message.number}'
            try:
                touches = decoded(message)
                if touches.run_id != answers.run_id:
                    continue
                answer = counting.get((touches.seq, nanoseconds(touches.header.stamp)))
                if answer is None or (touches.table_position, touches.ball) != (answer.table_position, answer.ball):
                    continue
                columns = _columns(touches)
            except (InvalidData, AttributeError, *BAD_VALUE) as error:
                raise InvalidData(f'{where}: {plain(str(error))}') from error
            if short_frame(touches.header.frame_id) != answer.frame:
                unused[answer.seq] = 'touches in another frame'
            elif not np.isfinite(columns[:3]).all():
                unused[answer.seq] = 'touches that are no numbers'
            else:
                found[answer.seq] = answer, columns, touches
    problems = Counter(why for seq, why in unused.items() if seq not in found)
    if not found:
        why = f'{NONE} of run {answers.run_id}' + ''.join(f'; {count} {words}' for words, count in problems.items())
        raise InvalidData(f'{log.path}: {why}; its CMM publishes none (topic touches)')
    missing = len(counting) - len(found) - problems.total()
    rows = [found[seq] for seq in sorted(found)]
    in_table = rows[0][0].frame != MACHINE_FRAME
    frame = None if in_table else log.frame_of(answers.run_id)
    columns, sent = np.concatenate([one for _, one, _ in rows], axis=1), [answer for answer, _, _ in rows]
    return TouchedBalls(
        seq=np.array([one.seq for one in sent]), ball=np.array([one.ball for one in sent]),
        table_position=np.array([one.table_position for one in sent]),
        table_angle=np.array([one.table_angle for one in sent]), sent=np.array([one.centre for one in sent]),
        tip=np.array([0.0 if one.is_compensated else one.tip_radius for _, _, one in rows]),
        owner=np.repeat(np.arange(len(rows)), [one.shape[1] for _, one, _ in rows]),
        point=columns[:3].T, normal=columns[3:6].T, time=columns[6],
        rotation=np.eye(3) if frame is None else frame.rotation,
        left_out={**({'no touches': missing} if missing else {}), **problems})


def _columns(touches: SimpleNamespace) -> Floats:
    """Return the arrays of a Touches message, (7, Q); raises InvalidData where they differ in length."""
    columns = [np.asarray(getattr(touches, name), dtype=float) for name in TOUCH_ARRAYS]
    sizes = [one.size for one in columns]
    if len(set(sizes)) > 1:
        raise InvalidData(f'expected {", ".join(TOUCH_ARRAYS)} of one length, found {", ".join(map(str, sizes))}')
    return np.array(columns)
