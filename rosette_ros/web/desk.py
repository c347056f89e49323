# SPDX-License-Identifier: Apache-2.0
"""Gets the work of a Session done beside the page: quick things first, the diagnosis afterwards.

Quick work is done in a thread, slow work in a process that is ended as soon as nobody asks for it any
more, so that a long diagnosis holds up nothing. Every piece of work carries its Ticket; what comes too
late is dropped.
"""

import asyncio

from rosette_ros.analysis import (
    advise_run,
    analyse,
    change,
    claimed_model,
    compare,
    cross_check,
    diagnose,
    ladder,
)
from rosette_ros.core.errors import RosetteError
from rosette_ros.report import open_source, report_html
from rosette_ros.story import MOST_BALLS_ADVISED
from rosette_ros.web.errand import Errands, Stale
from rosette_ros.web.session import Session

WORDS = {'evaluate': 'fitting the model', 'compare': 'comparing model and readings',
         'diagnose': 'looking for what is missing', 'ladder': 'trying what was found, one by one',
         'advise': 'comparing orders for the next run'}
STEPS = tuple(WORDS)
QUICK = ('evaluate',)
SECONDS_PER_READING = 0.004
"""What a diagnosis takes for each reading, roughly; told before it is begun."""


class Desk:
    """A Session whose work gets done, and the views that show it.

    step: name of the step that is on, '' when nothing is; error: words of what failed last.
    """

    def __init__(self, quick):
        """Start with an empty desk; quick: the ThreadPoolExecutor for what takes no time."""
        self.session = Session()
        self.step = ''
        self.error = ''
        self.check = None
        self._quick_thread, self._errands = quick, Errands()
        self._views = []
        self._busy_with = None

    # Views

    def watch(self, show):
        """Call `show()` whenever something has changed."""
        self._views.append(show)

    def unwatch(self, show):
        """Call it no more."""
        self._views.remove(show)

    def tell(self):
        """Let all views show what is on the desk."""
        for show in tuple(self._views):
            show()

    # What a person asks for

    async def open(self, path, run_id=None):
        """Open a run by its path and look at it; raises RosetteError in the words of all doors."""
        run, source = await self.do_quick(open_source, path, run_id)
        self.put(run, path.rstrip('/').rsplit('/', 1)[-1], source)

    def put(self, run, name, source=None):
        """Look at a run that is opened already."""
        self.session.open(run, name, source)
        self._put_away()

    async def report(self):
        """Return the report of what is on the desk, HTML; None as long as its story is not complete."""
        story = self.session.story
        if story is None:
            return None
        return await self._errands.run(report_html, story, self.session.current.source)

    def select(self, key):
        """Look at another opened run."""
        self.session.select(key)
        self._put_away()

    def act(self, action, *arguments):
        """Let the session do something, and show it."""
        done = getattr(self.session, action)(*arguments)
        self._put_away()
        return done

    def _put_away(self):
        self.error, self.check = '', None
        self.tell()

    async def preview(self, name, model):
        """Find out what another model would do; show it as a preview."""
        ticket, run, before = self.session.ticket, self.session.current.run, self.session.model
        done = await self.do_quick(_if_asked(self.session, ticket, change), run, before, model)
        if self.session.keep_preview(ticket, name, model, done):
            self.tell()

    async def cross_check(self, key):
        """Check on another opened run what the diagnosis of this one claims."""
        ticket, diagnosis = self.session.ticket, self.session.found.diagnosis
        other = self.session.run_of(key)
        done = await self._errands.run(cross_check, other.run, diagnosis)
        if self.session.is_current(ticket):
            self.check = (other.name, done)
            self.tell()

    async def refresh(self, unasked=True):
        """Find out what there is to know of the run under the model: quick things first.

        unasked: leave the diagnosis of a large run out.
        """
        ticket = self.session.ticket
        if ticket is None:
            return
        run, model = self.session.current.run, self.session.model
        if ticket != self._busy_with:
            self._errands.stop()
        self._busy_with = ticket
        try:
            await self._quick(ticket, run, model)
            if not (unasked and self.session.is_large):
                await self._slow(ticket, run, model)
        except Stale:
            return
        except RosetteError as error:
            self.session.keep(ticket, problem=one_line(error))
        if self.session.is_current(ticket):
            self.step = ''
            self.tell()

    async def _quick(self, ticket, run, model):
        found = self.session.found
        if found.report is None:
            await self._find('evaluate', ticket, 'report', analyse, run, model)
        if found.own_rungs is None and not self.session.is_large:
            await self._find('evaluate', ticket, 'own_rungs', ladder, run, model)

    async def _slow(self, ticket, run, model):
        found = self.session.found
        if found.comparison is None:
            await self._find('compare', ticket, 'comparison', compare, run, model)
        if found.diagnosis is None:
            await self._find('diagnose', ticket, 'diagnosis', diagnose, run, model)
        if self.session.found.rungs is None:
            await self._find('ladder', ticket, 'rungs', ladder, run, claimed_model(self.session.found.diagnosis))
        if not self.session.has_advice(ticket.run_key):
            self._begin(ticket, 'advise')
            advice = await self._errands.run(advise_run, run) if run.n <= MOST_BALLS_ADVISED else None
            self.session.keep_advice(ticket.run_key, advice)

    async def _find(self, step, ticket, part, function, *arguments):
        """Work one part of the findings out and show it; raises Stale where it came too late."""
        self._begin(ticket, step)
        if step in QUICK:
            value = await self.do_quick(_if_asked(self.session, ticket, function), *arguments)
        else:
            value = await self._errands.run(function, *arguments)
        if not self.session.keep(ticket, **{part: value}):
            raise Stale
        self.tell()

    def _begin(self, ticket, step):
        if not self.session.is_current(ticket):
            raise Stale
        if step != self.step:
            self.step = step
            self.tell()

    async def do_quick(self, function, *arguments):
        """Do something in the thread for quick things."""
        return await asyncio.get_running_loop().run_in_executor(self._quick_thread, function, *arguments)

    def close(self):
        """End what is on."""
        self._errands.stop()


def _if_asked(session, ticket, function):
    """Return a function that is only begun where the session still asks for it."""
    def begin(*arguments):
        if not session.is_current(ticket):
            raise Stale
        return function(*arguments)
    return begin


def one_line(error):
    """Return the words of an error as the command line prints them."""
    return ' '.join(str(error).split())
