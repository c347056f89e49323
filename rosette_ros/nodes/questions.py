# SPDX-License-Identifier: Apache-2.0
"""The services of the evaluator: diagnose a run, add an effect to the model, remove one."""

from rosette_msgs.srv import AddEffect, Diagnose, RemoveEffect

from rosette_ros.core.errors import RosetteError
from rosette_ros.nodes import convert, names
from rosette_ros.nodes.introspection import introspected_service


class Questions:
    """Answers with what an Analyst says; what becomes known is published too, before the answer.

    A question takes as long as its calculation, during which messages wait in their queues.
    """

    def __init__(self, node, analyst, results):
        """Create the services on a CellNode; results: Results."""
        self._node, self._analyst, self._results = node, analyst, results
        introspected_service(node, Diagnose, names.DIAGNOSE, self._on_diagnose)
        introspected_service(node, AddEffect, names.ADD_EFFECT, self._on_add)
        introspected_service(node, RemoveEffect, names.REMOVE_EFFECT, self._on_remove)

    def diagnose(self, run_id=''):
        """Diagnose a run, publish and return the Diagnosis message; raises RosetteError."""
        run, diagnosis = self._analyst.diagnose(run_id)
        return self._results.tell_diagnosis(run, diagnosis)

    def _on_diagnose(self, request, response):
        try:
            response.diagnosis = self.diagnose(request.run_id)
        except RosetteError as error:
            return self._refuse(names.DIAGNOSE, error, response)
        response.success, response.message = True, response.diagnosis.verdict
        return response

    def _on_add(self, request, response):
        try:
            exchange = self._analyst.add(request.run_id, request.effect, request.definition)
        except RosetteError as error:
            return self._refuse(names.ADD_EFFECT, error, response)
        return self._exchanged(exchange, response)

    def _on_remove(self, request, response):
        try:
            exchange = self._analyst.remove(request.run_id, request.effect)
        except RosetteError as error:
            return self._refuse(names.REMOVE_EFFECT, error, response)
        return self._exchanged(exchange, response)

    def _exchanged(self, exchange, response):
        """Publish and answer what a new model says of a run, and what it still lacks."""
        stamp = self._node.now().to_msg()
        response.before = convert.model_message(exchange.model_before, stamp, exchange.before)
        response.after = convert.model_message(exchange.after.model, stamp, exchange.after)
        response.error_motions = self._results.tell(exchange.after)
        response.success, response.message = True, exchange.words
        try:
            self.diagnose(exchange.run.run_id)
        except RosetteError as error:
            response.message += f'; not diagnosed: {error}'
        self._node.get_logger().info(response.message)
        return response

    def _refuse(self, name, error, response):
        """Answer why not; nothing has changed."""
        response.success, response.message = False, ' '.join(str(error).split())
        self._node.get_logger().warning(f'{name}: {response.message}')
        return response
