# SPDX-License-Identifier: Apache-2.0
"""What the evaluator answers is put to the CMM: a block that it refuses is replaced by the next best one."""

from types import SimpleNamespace

import pytest
from rosette_msgs.msg import Block
from rosette_msgs.srv import NextReadings

from rosette_ros.calibration.state_machine import Until, Warn
from rosette_ros.core.run.errors import CellError, InvalidPlan
from rosette_ros.core.run.scheme import plan
from rosette_ros.nodes.node_requests import NextBlock

WORDS = 'the CMM cannot measure this plan: no way to ball 2'


@pytest.fixture(autouse=True)
def without_ros(monkeypatch):
    """No client joins a graph; the service is not offered."""
    monkeypatch.setattr('rosette_ros.nodes.node_requests.RoleClient', lambda *_: SimpleNamespace(is_there=False))


class Rig:
    """An evaluator whose blocks begin at balls 1, 2, 3 ..., a CMM that refuses some, and a sequence that notes."""

    def __init__(self, refused=(), **response):
        """Take the balls that the CMM refuses, and what the evaluator answers otherwise."""
        self.refused, self.response, self.requests, self.heard = refused, response, [], []
        self.is_late, self.most = False, 12
        self.block = NextBlock(None, self, self)
        made = plan(3)
        self.sequence = SimpleNamespace(
            run_id='a', until=Until(0.95, 0.0, 0), limits=SimpleNamespace(attempts=3, evaluation_timeout=5.0),
            plan=SimpleNamespace(scheme=made, run_end=9, followed_by=lambda block: block),
            refuse_block=self.refuse_block,
            not_answered=lambda *what: self.heard.append(what) or ('not answered',),
            decided=lambda *what: self.heard.append(what) or ('decided',),
            not_decided=lambda *what: self.heard.append(what) or ('not decided',))

    def refuse_block(self, block):
        """Refuse a block that is longer than was asked for."""
        if block.ball.size > self.most:
            raise InvalidPlan('too many')

    def call(self, client, request, limit, done):
        """Answer at once."""
        self.requests.append(request)
        ball = len(request.refused) + 1
        done(NextReadings.Response(**{
            'success': True, 'text': 'A or B', 'block': Block(
                table_position=[1], ball=[ball], approach=[1], wait=[0.0]), **self.response}))

    def is_passed(self, run_id, block, now, begin):
        """Refuse a block whose ball is one of the refused."""
        if block.ball[0] in self.refused:
            raise CellError(WORDS)
        return True

    def ask(self):
        """Ask, and let time pass until something is decided; return all commands."""
        self.block.ask(self.sequence, 'hash', 12)
        commands = []
        for _ in range(10):
            commands += self.block.tick(self.sequence, 1.0)
        return commands


def test_a_block_that_the_cmm_takes():
    """It is decided once, as the evaluator has it."""
    rig = Rig()
    assert rig.ask() == ['decided']
    ((block, text, _, is_settled),) = rig.heard
    assert (block.ball.tolist(), text, is_settled) == ([1], 'A or B', False)
    (request,) = rig.requests
    assert (request.run_id, request.readings_hash, request.readings) == ('a', 'hash', 12)
    assert request.until_probability == 0.95


def test_a_block_that_the_cmm_refuses_is_replaced_by_the_next_best():
    """The evaluator is told which ones are refused."""
    rig = Rig(refused=(1, 2))
    assert rig.ask() == [Warn(f'{WORDS}; asking for other readings')] * 2 + ['decided']
    assert [[one.ball[0] for one in request.refused] for request in rig.requests] == [[], [1], [1, 2]]
    assert rig.heard[0][0].ball.tolist() == [3]


def test_a_cmm_that_refuses_every_block_ends_it():
    """Not for ever, and in its words."""
    rig = Rig(refused=range(1, 4), block=Block(table_position=[1], ball=[1], approach=[1], wait=[0.0]))
    assert rig.ask()[-1] == 'decided' and len(rig.requests) == 4
    ((block, text, _, _),) = rig.heard
    assert block is None and text == f'A or B; {WORDS}'


@pytest.mark.parametrize('response, heard', [
    ({'success': False, 'message': 'expected a run, found none yet'}, 'expected a run, found none yet'),
    ({'block': Block(table_position=[4], ball=[1], approach=[1], wait=[0.0])}, 'readings that are added: expected '
                                                                               'table'),
    ({'block': Block(table_position=[1], ball=[1, 2], approach=[1], wait=[0.0])}, 'readings that are added: expected')])
def test_an_answer_that_is_none(response, heard):
    """The sequence decides what becomes of it."""
    rig = Rig(**response)
    assert rig.ask() == ['not decided'] and rig.heard[0][0].startswith(heard)


def test_more_readings_than_were_asked_for():
    """They are not put to the CMM: the evaluator is asked again, not for ever."""
    rig = Rig(block=Block(table_position=[1] * 13, ball=[1] * 13, approach=[1] * 13, wait=[0.0] * 13))
    rig.refused = (1,)  # the CMM is not asked
    assert rig.ask() == ['not decided'] and rig.heard[0][0] == 'too many'


def test_an_evaluator_that_does_not_answer_in_time_is_not_asked_again():
    """It would first answer what it was asked before; the results that it has published are kept."""
    rig = Rig(success=False, message='the evaluator did not answer within 15 s')
    rig.is_late = True
    assert rig.ask() == ['not answered'] and rig.heard == [('the evaluator did not answer within 15 s',)]


def test_nothing_more_is_wanted():
    """Settled, or hopeless: no block."""
    rig = Rig(block=Block(), settled=True, text='warm-up')
    assert rig.ask() == ['decided'] and rig.heard == [(None, 'warm-up', 1.0, True)]


def test_an_answer_for_a_run_that_is_over_is_none_for_the_next():
    """Nothing of it is put to the CMM."""
    rig, other = Rig(), Rig()
    rig.block.ask(rig.sequence, 'hash', 12)
    assert rig.block.tick(other.sequence, 1.0) == () and rig.heard == other.heard == []


def test_an_evaluator_that_does_not_offer_it_is_refused_before_the_run():
    """In words; a run that does not go on needs none."""
    rig = Rig()
    with pytest.raises(CellError, match='until: expected an evaluator with the service evaluator/next_readings'):
        rig.block.refuse_none(rig.sequence)
    rig.sequence.until = None
    rig.block.refuse_none(rig.sequence)
