# SPDX-License-Identifier: Apache-2.0
"""Who of the cell is there, for the sequencer: complete, settled, gone, started anew."""

from rosette_ros.nodes import names
from rosette_ros.nodes.alive import Watch

SETTLING = 1.0
"""How long all nodes have to be there before a run: each finds each other in its own time, s."""


class Company:
    """The nodes that a calibration needs, as the graph and their heartbeats tell."""

    def __init__(self, node, recorder):
        """Watch them from a CellNode; recorder: RecorderLink."""
        self._node, self._recorder = node, recorder
        self._watches = {name: Watch(node, name) for name in names.NODES}
        self._complete_since = None
        self._present = frozenset()
        self.words = ''

    def missing(self, with_recorder):
        """Return what the cell lacks for a calibration, a list of words."""
        node, missing = self._node, []
        missing += [f'{watch.lives} nodes named {name}: wanted one in this domain and namespace; is another cell '
                    'running? Give each its own (--domain, --namespace)'
                    for name, watch in self._watches.items() if watch.lives > 1]
        if self._is_gone(names.CMM) or not (node.count_publishers(names.BALL_CENTRE) and self._listeners()):
            missing.append(f'no CMM: wanted one that listens to {names.PROBE_TARGET} and answers '
                           f'{names.BALL_CENTRE}, got none; start simulated_cmm or connect a CMM')
        elif not node.has_time():
            missing.append('no time: with use_sim_time the CMM publishes /clock, none has come')
        if self._is_gone(names.EVALUATOR) or not node.count_publishers(names.ERROR_MOTIONS):
            missing.append(f'no evaluator: wanted one that publishes {names.ERROR_MOTIONS}, got '
                           'none; start it')
        if with_recorder and (self._is_gone(names.RECORDER) or not self._recorder.is_there):
            missing.append(f'no recorder: wanted its service {names.START_RECORDING}, got none; '
                           'start it, or set require_recorder to false')
        return missing

    def look(self, now, with_recorder):
        """Look who is there; log what the cell lacks, and when it has become complete and settled."""
        lacks = '; '.join(self.missing(with_recorder))
        present = self._ends()
        if lacks or present != self._present:
            self._complete_since, self._present = None, present
        if not lacks and self._complete_since is None:
            self._complete_since = now
        words = lacks or (names.COMPLETE if self.is_settled(now) else 'the nodes are getting connected')
        if words != self.words:
            self.words = words
            self._node.get_logger().info(words)

    def is_settled(self, now):
        """Whether all nodes have been there long enough to know each other, and the recorder hears the CMM."""
        return (self._complete_since is not None and now - self._complete_since >= SETTLING
                and self._is_recorded())

    def _is_recorded(self):
        """Return whether the recorder says that it hears the CMM; True where one of them does not beat."""
        cmm, recorder = self._watches[names.CMM], self._watches[names.RECORDER]
        return not (cmm.life and recorder.life) or recorder.has_gone or cmm.life in recorder.hears

    def lives(self):
        """Return the processes that serve a run now, by node; who does not beat is left out."""
        return {name: self._watches[name].life for name in (names.CMM, names.RECORDER)
                if self._watches[name].life}

    def gone(self, lives):
        """Return the nodes of a run that are not there."""
        return [name for name in lives if self._watches[name].has_gone]

    def started_anew(self, lives):
        """Return the nodes of a run that are another process than it began with."""
        return [name for name, life in lives.items() if self._watches[name].life != life]

    def trouble(self, lives):
        """Return why a node of a run cannot do its work, in its own words, '' where all can."""
        return '; '.join(self._watches[name].words for name in lives if self._watches[name].words)

    def silent(self):
        """Return the nodes that are there and do not beat: they hang, or their computer is overloaded."""
        return [name for name, watch in self._watches.items() if watch.is_late and not watch.has_gone]

    def _is_gone(self, name):
        return self._watches[name].has_gone

    def _listeners(self):
        """Return how many listen to the targets besides recorder and evaluator."""
        topic = self._node.resolve_topic_name(names.PROBE_TARGET)
        return sum(info.node_name not in (names.RECORDER, names.EVALUATOR)
                   for info in self._node.get_subscriptions_info_by_topic(topic))

    def _ends(self):
        """Return what tells who speaks and hears in the cell from a successor that has just come."""
        node = self._node
        centres, motions = map(node.resolve_topic_name, (names.BALL_CENTRE, names.ERROR_MOTIONS))
        infos = (*node.get_publishers_info_by_topic(centres), *node.get_publishers_info_by_topic(motions),
                 *node.get_subscriptions_info_by_topic(centres))
        return frozenset(bytes(info.endpoint_gid) for info in infos)
