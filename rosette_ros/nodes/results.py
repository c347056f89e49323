# SPDX-License-Identifier: Apache-2.0
"""What the evaluator makes known: the model in use, error motions, diagnosis; all latched."""

from rosette_msgs.msg import Diagnosis, ErrorMotions, Model

from rosette_ros.data.assemble import TABLE_FRAME
from rosette_ros.nodes import convert, names, qos


class Results:
    """The publishers of the evaluator."""

    def __init__(self, node):
        """Create them on a CellNode."""
        self._node = node
        self._motions = node.create_publisher(ErrorMotions, names.ERROR_MOTIONS, qos.RESULT)
        self._models = node.create_publisher(Model, names.MODEL, qos.RESULT)
        self._diagnoses = node.create_publisher(Diagnosis, names.DIAGNOSIS, qos.RESULT)

    def tell_model(self, model):
        """Publish a model that has not been fitted to any run."""
        self._models.publish(convert.model_message(model, self._stamp()))

    def tell(self, report):
        """Publish model and error motions of a Report; the error motions come last."""
        stamp = self._stamp()
        self._models.publish(convert.model_message(report.model, stamp, report))
        message = convert.error_motions_message(report.run, report, stamp, TABLE_FRAME)
        self._motions.publish(message)
        return message

    def tell_diagnosis(self, run, diagnosis):
        """Publish a Diagnosis of a run and return its message."""
        message = convert.diagnosis_message(run, diagnosis, self._stamp())
        self._diagnoses.publish(message)
        return message

    def _stamp(self):
        return self._node.now().to_msg()
