# SPDX-License-Identifier: Apache-2.0
"""Which answer counts for which target, and what the Run takes from it."""

import math
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosette_msgs.msg import BallCentre
from std_msgs.msg import Header

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Frame
from rosette_ros.core.run.remarks import RemarkKind
from rosette_ros.io.log_run import LogRun
from rosette_ros.io.messages import Answer, Phase, Rows, TableFrame, Target, answer_of, table_frame_of
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import RunAssembly
from rosette_ros.words.reading_words import remark_words

N, RADIUS, S = 3, 0.1, 10**9
CELLS = [(i, j) for i in range(1, N + 1) for j in range(1, N + 1)]
ARRAYS = ('table_position', 'ball', 'centre', 'time', 'table_travel', 'temperature', 'session')


def nominal(i, j):
    azimuth = 2 * math.pi * ((i + j - 2) % N) / N
    return RADIUS * math.cos(azimuth), RADIUS * math.sin(azimuth), 0.0


def target(seq, **changes):
    """Return the target of the seq-th cell, asked at seq s."""
    i, j = CELLS[(seq - 1) % len(CELLS)]
    made = Target('r', seq, 1, 1, Phase.RUN, N, RADIUS, i, j, (i + j - 2) % N + 1, 2 * math.pi * (i - 1) / N, 1,
                  nominal(i, j), 'table', S * seq)
    return made._replace(**changes)


def answer(seq, **changes):
    """Return the answer to it, measured 0.5 s after the asking."""
    i, j = CELLS[(seq - 1) % len(CELLS)]
    made = Answer('r', seq, i, j, (i + j - 2) % N + 1, 0, '', 2 * math.pi * (i - 1) / N, float(seq - 1), 1,
                  nominal(i, j), 0.0, 20.0, 'table', S * seq + S // 2)
    return made._replace(**changes)


TARGETS = [target(seq) for seq in range(1, 10)]
ANSWERS = [answer(seq) for seq in range(1, 10)]


def collected(targets=TARGETS, answers=ANSWERS, frames=()):
    """Return the RunAnswers of targets and answers in this order."""
    run = RunAnswers('r', list(frames))
    for one in targets:
        run.add_target(one)
    for one in answers:
        run.add_answer(one)
    return run


def same(one, other):
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in ARRAYS)


def test_run_holds_what_was_measured():
    """Everything in order of measuring, the time from the first reading."""
    run = RunAssembly(collected(), 'here').run()
    assert (run.n, run.radius, run.run_id, run.source) == (N, RADIUS, 'r', 'here')
    assert run.is_complete
    assert run.time.tolist() == list(range(9))
    assert run.table_travel.tolist() == list(range(9))
    assert run.repeatability is None


def test_missing_balls_make_an_incomplete_run():
    """Failed, never answered, asked without answer: no error, but fewer readings."""
    known = collected(answers=[answer(seq, status=int(seq == 2)) for seq in range(1, 8)])
    assert (known.answered, known.is_complete, known.counts()) == (6, False, {Phase.RUN: (9, 6)})
    run = RunAssembly(known).run()
    assert run.size == 6
    assert not run.is_complete


def test_the_way_of_the_cmm_is_that_of_all_targets():
    """A ball that was not found was gone to; of an imported table only what is in it is known."""
    shuffled = [5, 1, 9, 3, 7, 2, 8, 6, 4]
    cells = dict(zip(range(1, 10), [CELLS[cell - 1] for cell in shuffled]))

    def placed(one):
        i, j = cells[one.seq]
        return one._replace(table_position=i, ball=j, cmm_position=(i + j - 2) % N + 1, centre=nominal(i, j),
                            table_angle=2 * math.pi * (i - 1) / N)

    targets = [placed(one) for one in TARGETS]
    whole = collected(targets, [placed(one) for one in ANSWERS])
    kept = [row for row in range(9) if row not in (2, 6)]
    lost = RunAssembly(collected(targets, [whole.answers[row] for row in kept])).run()
    assert lost.unrecorded == ()
    assert lost.cmm_sense.tolist() == RunAssembly(whole).run().cmm_sense[kept].tolist()
    imported = RunAssembly(collected([targets[row] for row in kept], [whole.answers[row] for row in kept])).run()
    assert imported.unrecorded == ('table_travel', 'cmm_sense')


def test_answers_are_sorted_by_when_they_were_measured():
    """A ball that was put off stands where it was measured, not where it was asked."""
    late = [answer(seq, stamp_ns=S * (20 if seq == 2 else seq)) for seq in range(1, 10)]
    run = RunAssembly(collected(answers=late)).run()
    assert run.time.tolist() == [0, 2, 3, 4, 5, 6, 7, 8, 19]
    assert (run.table_position[-1], run.ball[-1]) == (1, 2)


def test_of_two_good_answers_the_first_after_the_last_asking_counts():
    """The answer to a repeated target counts, not the late one to the first time of asking."""
    again = [answer(2, stamp_ns=13 * S), answer(2, stamp_ns=14 * S)]
    known = collected([*TARGETS, target(2, attempt=2, stamp_ns=12 * S)], [*ANSWERS, *again])
    assert known.answer_to(2) == again[0]
    assert known.unused()['repeated'] == 2
    assert known.last_target(2).attempt == 2


def test_two_answers_that_differ_are_told():
    """A second node answered, 10 µm higher; the same answer again, or one to a target asked twice, is none."""
    x, y, _ = nominal(*CELLS[3])
    other = answer(4, centre=(x, y, 1e-5), stamp_ns=4 * S + S // 3)
    [told] = [remark_words(one) for one in RunAssembly(collected(answers=[*ANSWERS, other])).run().remarks
              if one.kind is RemarkKind.TWO_ANSWERS]
    assert told == ('target 4 (table position 2, ball 1) has two answers that differ by 10.0 µm, of which the '
                    'first counts; did a second node answer? Measure again with one CMM')
    for run in (collected(answers=[*ANSWERS, ANSWERS[3]]),
                collected([*TARGETS, target(4, attempt=2, stamp_ns=20 * S)], [*ANSWERS, other])):
        assert not any(one.kind is RemarkKind.TWO_ANSWERS for one in RunAssembly(run).run().remarks)


def test_without_an_answer_after_the_last_asking_the_first_counts():
    """A late answer is better than none; nothing is asked of a clock that lags."""
    known = collected([*TARGETS, target(2, attempt=2, stamp_ns=99 * S)])
    assert [one for _, one in known.counting()] == ANSWERS


def test_a_target_of_an_earlier_attempt_that_arrives_late_changes_nothing():
    """What was asked last is decided by the attempt."""
    known = collected([target(1, attempt=2, stamp_ns=50 * S), target(1)], [answer(1), answer(1, stamp_ns=51 * S)])
    assert known.answer_to(1).stamp_ns == 51 * S


def test_a_later_session_counts_whatever_its_attempt():
    """An attempt that the log lost when its recorder was killed is not counted by the next session."""
    lost, again = target(2, attempt=3, stamp_ns=12 * S), target(2, attempt=2, session=2, stamp_ns=20 * S)
    answers = [answer(2, stamp_ns=13 * S, centre=(0.1, 0.2, 0.0)), answer(2, stamp_ns=21 * S)]
    for targets in ([*TARGETS, lost, again], [*TARGETS, again, lost]):
        known = collected(targets, [*ANSWERS, *answers])
        assert known.last_target(2) == again
        assert known.answer_to(2) == answers[1]
        assert not any(one.kind is RemarkKind.TWO_ANSWERS for one in RunAssembly(known).run().remarks)
    recorded = collected([*TARGETS, again], [*ANSWERS, answers[1]])
    assert known.readings_hash == recorded.readings_hash


def test_answers_that_do_not_fit_are_counted_and_not_used():
    """Failed, to no target, with another ball than asked, not finite: each has its count."""
    bad = [answer(1, status=1), answer(77, table_position=1, ball=1), answer(6, table_position=3, ball=3),
           answer(7, table_angle=math.nan)]
    known = collected(answers=[*bad, *ANSWERS[1:5]])
    assert known.unused() == {'failed': 1, 'to no target': 1, 'with another ball than asked': 1,
                              'without finite numbers': 1, 'in another frame than table': 0, 'repeated': 0}
    assert [one.seq for one, _ in known.counting()] == [2, 3, 4, 5]
    with pytest.raises(InvalidData, match=r"here: expected ball centres of run 'r', found none that counts \(1 failed, "
                       r'1 to no target, 1 with another ball than asked, 1 without finite numbers\)'):
        RunAssembly(collected(answers=bad), 'here').run()


@settings(max_examples=60, deadline=None)
@given(st.permutations(range(9)), st.permutations(range(18)), st.lists(st.integers(0, 8), max_size=6),
       st.sets(st.integers(0, 8), max_size=4))
def test_order_of_arrival_and_duplicates_do_not_matter(order, between, again, failed):
    """Any order on the way, also between the topics, any duplicates behind it: the same Run, bit for bit."""
    answers = [one._replace(status=int(row in failed)) for row, one in enumerate(ANSWERS)]
    arriving = [*(TARGETS[row] for row in order), *(answers[row] for row in order)]
    known = RunAnswers('r')
    for one in (*(arriving[row] for row in between), *(answers[row] for row in again)):
        known.add_target(one) if isinstance(one, Target) else known.add_answer(one)
    assert known.answered == 9 - len(failed)
    assert same(RunAssembly(known).run(), RunAssembly(collected(answers=answers)).run())


ASKED = st.lists(st.tuples(st.just('asked'), st.integers(1, 9), st.integers(0, 99)), max_size=9)
GIVEN = st.lists(st.tuples(st.just('given'), st.integers(1, 9), st.integers(0, 99)), min_size=1, max_size=20)


@settings(max_examples=100, deadline=None)
@given(ASKED, GIVEN, st.randoms(use_true_random=False))
def test_interleaving_of_the_topics_does_not_matter(asked, given, random):
    """Targets asked again and several answers to each: topics keep their own order, not that to each other."""
    targets, answers = list(TARGETS), []
    for _, seq, stamp in asked:
        attempt = 1 + sum(one.seq == seq for one in targets)
        targets.append(target(seq, attempt=attempt, stamp_ns=S * stamp))
    answers = [answer(seq, stamp_ns=S * stamp, temperature=float(place))
               for place, (_, seq, stamp) in enumerate(given)]
    turns = ['target'] * len(targets) + ['answer'] * len(answers)
    random.shuffle(turns)
    mixed, waiting = RunAnswers('r'), {'target': iter(targets), 'answer': iter(answers)}
    for turn in turns:
        mixed.add_target(next(waiting[turn])) if turn == 'target' else mixed.add_answer(next(waiting[turn]))
    plain = collected(targets, answers)
    assert mixed.counting() == plain.counting()
    assert mixed.answered == plain.answered == len(plain.counting())
    assert same(RunAssembly(mixed).run(), RunAssembly(plain).run())


@settings(max_examples=60, deadline=None)
@given(st.sets(st.integers(0, 17)), st.sets(st.integers(0, 17)))
def test_what_a_log_lacks_of_a_run_makes_it_whole(received, recorded):
    """Each may lack what the other has; nothing is counted twice."""
    def part(rows):
        return collected([TARGETS[row] for row in sorted(rows) if row < 9],
                         [ANSWERS[row - 9] for row in sorted(rows) if row >= 9])

    log, union = part(recorded), part(received | recorded)
    targets, answers = part(received).lacking_in(log)
    for one in targets:
        log.add_target(one)
    for one in answers:
        log.add_answer(one)
    assert sorted(log.targets) == sorted(union.targets)
    assert sorted(log.answers) == sorted(union.answers)
    assert log.readings_hash == union.readings_hash


def test_a_run_whose_targets_became_others_is_not_complete():
    """The last target of every seq is of another phase."""
    others = [one._replace(phase=Phase.ALIGNMENT, attempt=2) for one in TARGETS]
    assert not collected([*TARGETS, *others]).is_complete


@pytest.mark.parametrize('texts', [1, 1_000_000])
def test_foreign_answers_take_bounded_memory_and_change_nothing(texts):
    """Answers to no target, to one target again and again, with long texts; of too many to one target the one that
    counts is kept, also when it is asked again."""
    known, text = collected(answers=()), '\x1b[31m' * texts
    foreign = BallCentre(run_id='r', status=BallCentre.STATUS_FAILED, text=text, header=Header(frame_id=text))
    for number in range(15_000 if texts == 1 else 200):
        foreign.seq = number if number % 2 else 1
        known.add_answer(answer_of(foreign))
    for one in ANSWERS:
        known.add_answer(one)
    assert len(known.answers) < 11_000
    assert max(len(one.text) + len(one.frame_id) for one in known.answers) < 1100
    assert not any('\x1b' in one.text + one.frame_id for one in known.answers)
    assert same(RunAssembly(known).run(), RunAssembly(collected()).run())
    known.add_target(target(1, attempt=2, stamp_ns=50 * S))
    known.add_answer(answer(1, stamp_ns=51 * S))
    assert known.answer_to(1).stamp_ns == 51 * S


@pytest.mark.parametrize(('known', 'words'), [
    (collected(), ''),
    (collected(answers=ANSWERS[:4]), 'expected 9 targets with answers, found 9 targets and answers to 4'),
    (collected([one._replace(phase=2) for one in TARGETS]), 'expected 9 targets with answers, found 9 targets'),
    (collected(answers=[one._replace(frame_id='machine') for one in ANSWERS]), 'expected the table frame on '
                                                                               '/tf_static'),
    (collected(answers=[one._replace(frame_id='machine') for one in ANSWERS],
               frames=[TableFrame(1 * S, Frame.identity())]), ''),
    (collected(answers=[one._replace(frame_id='machine') for one in ANSWERS],
               frames=[TableFrame(S - 1, Frame.identity())]), 'found none for this run'),
])
def test_what_is_lacking_is_said(known, words):
    """Answers, the run itself, or the frame that was found in it: an earlier one is that of another run."""
    assert known.lacking(9).startswith(words) if words.startswith('expected') else words in known.lacking(9)
    assert bool(known.lacking(9)) == bool(words)


def test_repeatability_is_pooled_over_balls_and_axes():
    """Compared with a calculation by hand: squares 2 + 0.5 over 3 (3-1) + 3 (2-1) = 9 degrees."""
    places = [(1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 2), (1, 1, 2), (2, 1, 1)]
    centres = [(1, 5, 5), (-1, 5, 5), (0, 5, 5), (7, 0.5, 0), (7, -0.5, 0), (9, 9, 9)]
    known = collected(
        [target(seq, phase=phase, table_position=i, ball=j) for seq, (phase, i, j) in enumerate(places, 1)],
        [answer(seq, table_position=i, ball=j, centre=tuple(1e-6 * x for x in centre))
         for seq, ((_, i, j), centre) in enumerate(zip(places, centres), 1)])
    sigma, dof = RunAssembly(known).repeatability()
    assert dof == 9
    assert sigma == pytest.approx(1e-6 * np.sqrt(2.5 / 9), rel=1e-12)


def test_repeatability_needs_repeats_that_differ():
    """One reading tells nothing; readings equal to rounding neither."""
    asked = [target(seq, phase=1, table_position=1, ball=1) for seq in (1, 2)]
    given = [answer(seq, table_position=1, ball=1, centre=(1.0, 2.0, 3.0)) for seq in (1, 2)]
    assert RunAssembly(collected(asked, given)).repeatability() == (None, None)
    assert RunAssembly(collected(asked, given[:1])).repeatability() == (None, None)


FRAME = Frame(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2, 3]))


def in_machine(one):
    """Return an answer in the machine frame, R p + o by hand."""
    x, y, z = one.centre
    return one._replace(centre=(1 - y, 2 + x, 3 + z), frame_id='cell1/machine')


def test_machine_frame_is_turned_into_the_table_frame():
    """p_table = R^T (p_machine - o)."""
    run = RunAssembly(collected(answers=map(in_machine, ANSWERS), frames=[TableFrame(0, FRAME)])).run()
    np.testing.assert_allclose(run.centre, [one.centre for one in ANSWERS], atol=1e-15)
    assert run.centre[4].tolist() == list(ANSWERS[4].centre)


@pytest.mark.parametrize('others', [('cell1/table', 'cell1/table'), ('cell1/table', 'tool')])
@pytest.mark.parametrize('in_table', [True, False])
def test_frames_are_never_mixed(in_table, others):
    """Most answers decide in which order ever they come; those in other frames are counted and not used."""
    answers = ANSWERS if in_table else [*map(in_machine, ANSWERS)]
    others = [one.replace('cell1/table', 'machine') for one in others] if in_table else others
    for wrong in ((1, 2), (4, 8)):
        given = [one._replace(frame_id=others[wrong.index(one.seq)]) if one.seq in wrong else one for one in answers]
        for order in (given, given[::-1]):
            known = collected(answers=order, frames=[TableFrame(S // 2, FRAME)])
            run = RunAssembly(known).run()
            assert not set(zip(run.table_position, run.ball)) & {CELLS[seq - 1] for seq in wrong}
            assert (run.size, known.answered, [one.seq for one in known.failed()]) == (7, 7, [*wrong])
            assert known.unused()[f'in another frame than {"table" if in_table else "machine"}'] == 2
            assert known.is_in_table_frame == in_table
            for seq in wrong:
                known.add_target(target(seq, attempt=2, stamp_ns=50 * S))
                known.add_answer(answers[seq - 1]._replace(stamp_ns=51 * S))
            run = RunAssembly(known).run()
            expected = [nominal(*one) for one in zip(run.table_position, run.ball, strict=True)]
            np.testing.assert_allclose(run.centre, expected, atol=1e-15)
            assert bool(known.lacking(9)) != in_table  # the transform is older than the first target


def test_the_frame_is_the_last_before_the_run():
    """Later ones are of another run; without any before it, the first of all is taken."""
    frames = [TableFrame(stamp, Frame(np.eye(3), np.full(3, float(stamp)))) for stamp in (0, S // 2, 2 * S)]
    assert RunAssembly(collected(frames=frames)).frame().origin[0] == S // 2
    assert RunAssembly(collected(frames=frames[2:])).frame().origin[0] == 2 * S
    assert RunAssembly(collected()).frame() is None


def test_two_frames_during_an_alignment_are_refused():
    """Two cells share /tf_static; in an earlier session of the alignment another frame may have been found."""
    aligning = [target(10, phase=2, stamp_ns=S // 10), target(11, phase=2, stamp_ns=S // 2, session=2)]
    answers = [in_machine(one) for one in ANSWERS]
    other = Frame(FRAME.rotation, FRAME.origin + 1e-9)
    frames = [TableFrame(S // 5, other), TableFrame(S // 2 + 1, FRAME)]
    run = [one._replace(session=2) for one in TARGETS]
    assert RunAssembly(collected([*aligning, *run], answers, frames)).run().size == 9
    with pytest.raises(InvalidData, match='here: expected one table frame for run r, found 2 that differ; two cells'):
        RunAssembly(collected([aligning[0], *TARGETS], answers, frames), 'here').run()
    twice = [TableFrame(S // 5, FRAME), TableFrame(S // 2, FRAME)]
    assert RunAssembly(collected([aligning[0], *TARGETS], answers, twice)).run().size == 9


@pytest.mark.parametrize('stamp', [S // 5, S // 2, 3600 * S])
def test_a_frame_of_an_earlier_run_is_not_that_of_this_one(stamp):
    """The clock of the CMM was ahead, so its stamp lies in this run or after it; it came before the first target."""
    run = RunAnswers('r', [TableFrame(stamp, Frame(np.eye(3), np.zeros(3)))])
    run.add_target(target(10, phase=2, stamp_ns=S // 10))
    run.frames.append(TableFrame(S // 3, FRAME))
    for one in TARGETS:
        run.add_target(one)
    for one in map(in_machine, ANSWERS):
        run.add_answer(one)
    assert RunAssembly(run).run().size == 9
    assert all(RunAssembly(one).frame() is FRAME for one in (run, run.with_centres({})))


def test_a_run_that_is_resumed_on_a_clock_that_lags_by_an_hour():
    """The frame that was found before the pause is that of the run; where the alignment was repeated, the later one."""
    ahead = 3600 * S
    run = RunAnswers('r')
    run.add_target(target(10, phase=2, stamp_ns=ahead + S // 10))
    run.frames.append(TableFrame(ahead + S // 3, FRAME))
    for seq in range(1, 10):
        later = {'session': 2} if seq > 4 else {'stamp_ns': ahead + S * seq}
        run.add_target(target(seq, **later))
        run.add_answer(in_machine(answer(seq, stamp_ns=S * seq + S // 2 + ahead * (seq < 5))))
    assert (run.lacking(9), RunAssembly(run).frame(), RunAssembly(run).run().size) == ('', FRAME, 9)
    again = RunAnswers('r')
    again.add_target(target(10, phase=2, stamp_ns=ahead + S // 10))
    again.frames.append(TableFrame(ahead + S // 3, Frame(np.eye(3), np.zeros(3))))
    again.add_target(target(10, phase=2, stamp_ns=S // 10, session=2))
    again.frames.append(TableFrame(S // 3, FRAME))
    for seq in range(1, 10):
        again.add_target(target(seq, session=2))
        again.add_answer(in_machine(answer(seq)))
    assert (again.lacking(9), RunAssembly(again).frame(), RunAssembly(again).run().size) == ('', FRAME, 9)


def transform(parent='machine', child='cell/table', rotation=(0, 0, 0, 1), translation=(1, 2, 3)):
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=parent, stamp=SimpleNamespace(sec=1, nanosec=5)), child_frame_id=child,
        transform=SimpleNamespace(rotation=SimpleNamespace(**dict(zip('xyzw', rotation))),
                                  translation=SimpleNamespace(**dict(zip('xyz', translation)))))


def test_only_transforms_of_the_table_in_the_machine_are_table_frames():
    """By the last part of their names; what is no rotation or place is refused."""
    found = table_frame_of(transform())
    assert (found.stamp_ns, found.frame.origin.tolist()) == (S + 5, [1, 2, 3])
    assert table_frame_of(transform(child='probe')) is None
    assert table_frame_of(transform(parent='table', child='machine')) is None
    with pytest.raises(InvalidData, match=r'table frame: rotation: expected a unit quaternion, found the size 2\.0'):
        table_frame_of(transform(rotation=(0, 0, 0, 2)))
    with pytest.raises(InvalidData, match='table frame: translation: expected finite numbers'):
        table_frame_of(transform(translation=(1, math.nan, 3)))


@pytest.mark.parametrize(('asked', 'given', 'words'), [
    ({}, lambda one: one._replace(frame_id='tool'),
     "here: expected ball centres of run 'r', found none that counts \\(9 in another frame than machine or table\\)"),
    ({}, lambda one: one._replace(frame_id='machine'),
     'here: expected a transform from machine to table on /tf_static, found none'),
    ({'balls': 4}, None, "here: run 'r': balls: expected one value in all targets, found 3, 4"),
    ({'radius': 0.2}, None, 'radius: expected one value in all targets'),
    ({}, lambda one: one._replace(run_id='s', seq=one.seq + 9), "here: expected ball centres of run 'r', found none"),
    ({}, lambda one: one._replace(centre=tuple(-x for x in one.centre)),
     'here: ball centre with seq 1: expected a place near '
     r'\(100.000, 0.000, 0\) mm in the table frame for table position 1, ball 1, found \(-100, -0, -0'
     r'\); was another ball measured, or is the table frame wrong'),
    ({}, lambda one: one._replace(centre=(1e300,) * 3), 'here: ball centre with seq 1: expected a place'),
])
def test_what_is_no_run_is_refused_with_words(asked, given, words):
    """Each says where, what was wanted, what came; asked: of the last target."""
    targets = [*TARGETS[:8], TARGETS[8]._replace(**asked)]
    with pytest.raises(InvalidData, match=words):
        RunAssembly(collected(targets, map(given or (lambda one: one), ANSWERS)), 'here').run()


def test_too_many_balls_are_a_mistake():
    """Before memory is asked for."""
    with pytest.raises(InvalidData, match='balls: expected at most 10000, found 1000000000'):
        RunAssembly(collected([one._replace(balls=10**9) for one in TARGETS])).run()


def test_a_run_is_chosen_among_those_that_have_begun():
    """In order of appearance; one that ended before its phase RUN is none."""
    runs = {name: collected([one._replace(phase=phase) for one in TARGETS])
            for name, phase in (('b', 3), ('a', 3), ('c', 2))}
    assert LogRun(Path('here'), (), runs).run('a') is runs['a']
    assert LogRun(Path('here'), (), {'b': runs['b'], 'c': runs['c']}).run() is runs['b']
    with pytest.raises(InvalidData, match='here: expected one run, found 2: b, a; choose one by its run_id'):
        LogRun(Path('here'), (), runs).run()
    with pytest.raises(InvalidData, match="here: expected run 'c', found b, a$"):
        LogRun(Path('here'), (), runs).run('c')
    with pytest.raises(InvalidData, match='here: expected probe targets of phase RUN, found none'):
        LogRun(Path('here'), (), {'c': runs['c']}).run()


def test_infinite_temperature_is_unknown():
    """A broken sensor does not spoil the ball centre."""
    answers = [one._replace(temperature={1: math.inf, 2: math.nan}.get(one.seq, 20.0)) for one in ANSWERS]
    assert np.isnan(RunAssembly(collected(answers=answers)).run().temperature[:2]).all()


def in_sessions(first_of_second):
    return [one._replace(session=1 + (one.seq >= first_of_second)) for one in TARGETS]


def test_a_pause_is_marked_and_the_order_is_that_of_the_sessions():
    """Clocks may disagree over a pause; what was measured after it comes after it."""
    answers = [one._replace(stamp_ns=S * (200 + one.seq - 100 * (one.seq >= 5))) for one in ANSWERS]
    run = RunAssembly(collected(in_sessions(5), answers)).run()
    assert run.session.tolist() == [1] * 4 + [2] * 5
    assert run.pauses == (4,)
    assert run.ball.tolist() == [j for _, j in CELLS]
    assert run.take(np.arange(2, 9)).pauses == (2,)


TURNED = 2 * np.pi * np.arange(9) / 3


@pytest.mark.parametrize(('after', 'wanted'), [
    (TURNED[5:] - TURNED[5] + 0.1, TURNED[5:]),  # the table counts from 0 again
    (TURNED[5:] + 2 * np.pi, TURNED[5:] + 2 * np.pi),  # it went on, and turned once more during the pause
])
def test_the_travel_continues_where_the_table_counts_from_0_again(after, wanted):
    """A restarted controller counts from 0: the run's travel continues by the shortest way in its sense."""
    places = [{'table_position': (seq - 1) % 3 + 1, 'ball': (seq - 1) // 3 + 1} for seq in range(1, 10)]
    travel = np.concatenate([TURNED[:5], after]).tolist()
    answers = [one._replace(**place, table_angle=TURNED[place['table_position'] - 1], table_travel=travel[one.seq - 1],
                            centre=nominal(place['table_position'], place['ball']))
               for one, place in zip(ANSWERS, places)]
    targets = [one._replace(**place, table_angle=TURNED[place['table_position'] - 1])
               for one, place in zip(in_sessions(6), places)]
    run = RunAssembly(collected(targets, answers)).run()
    assert run.table_travel == pytest.approx(np.concatenate([TURNED[:5], wanted]), abs=1e-12)


def test_times_do_not_fall_over_a_pause():
    """A clock that was set back, or a simulated one that began again: the pause is as long as readings are apart."""
    def times(jump):
        answers = [one._replace(stamp_ns=S * (one.seq + 10_000 + jump * (one.seq >= 5))) for one in ANSWERS]
        return RunAssembly(collected(in_sessions(5), answers)).run().time

    assert times(-5000).tolist() == list(range(9))
    assert times(5000)[4] - times(5000)[3] == 5001


def test_repeatability_by_axis_is_along_the_table_frame():
    """What the CMM repeats worst along its x is z of a table whose axis lies along x; unknown without the frame."""
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # x, y, z of the table are y, z, x of the machine
    asked = [target(seq, phase=1, table_position=1, ball=1) for seq in (1, 2, 3)]
    given = [answer(seq, table_position=1, ball=1, centre=(x, y, z), frame_id='machine')
             for seq, (x, y, z) in enumerate(((3e-6, 1e-6, 0), (-3e-6, 1e-6, 2e-6), (0, -2e-6, 1e-6)), 1)]
    known = collected(asked, given)
    assert RunAssembly(known)._repeatability_axes(turn) == pytest.approx((np.sqrt(3e-12), 1e-6, 3e-6))
    assert RunAssembly(known)._repeatability_axes(None) is None


def test_records_are_kept_in_columns():
    """Every field comes back, negative places and slices, too; a reading takes 0.4 kB, where objects take 1 kB."""
    targets, answers = Rows(Target), Rows(Answer)
    asked = [target(1 + k % 9)._replace(seq=k, stamp_ns=S * k, table_angle=k / 7) for k in range(3000)]
    got = [answer(1 + k % 9)._replace(seq=k, text='' if k % 5 else 'slow', form_error=k / 3e9) for k in range(3000)]
    tracemalloc.start()
    for one, other in zip(asked, got, strict=True):
        targets.append(one)
        answers.append(other)
    size = tracemalloc.get_traced_memory()[0] / 3000
    tracemalloc.stop()
    assert size < 400
    assert (list(targets), list(answers)) == (asked, got)
    assert (targets[-1], answers[5:7], answers.column('text')) == (asked[-1], got[5:7], [one.text for one in got])
    assert targets.column('centre')[3:6] == list(asked[1].centre)
