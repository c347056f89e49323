# SPDX-License-Identifier: Apache-2.0
"""Several runs as one: from the request, and to the message."""

import math

import numpy as np
from builtin_interfaces.msg import Time
from rosette_msgs import msg
from std_msgs.msg import Header

from rosette_ros.core import records
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.joint.sharing import ITEMS
from rosette_ros.words.result_words import conclusion_text


def joint_message(result: JointResult, stamp: Time, frame_id: str) -> msg.JointEvaluation:
    """Return the JointEvaluation message of a joint evaluation."""
    solution, verdict, unknown = result.solution, conclusion_text(conclude(result)), math.nan
    return msg.JointEvaluation(
        header=Header(stamp=stamp, frame_id=frame_id), run_ids=[run.run_id for run in solution.model.runs],
        verdict=verdict.sentence, level=str(verdict.level), action=verdict.action,
        curves=[joint_curves(motions, one.name, one.sense) for one, motions in result.curves],
        reversals=[joint_curves(
            one.motions, one.table, mean=np.where(one.is_known, one.mean, unknown).tolist(),
            u_mean=np.where(one.is_known, one.u_mean, unknown).tolist(), p=unknown if one.p is None else one.p)
            for one in result.reversals],
        tests=[msg.SharingTest(
            item=test.item, text=ITEMS[test.item], declared=test.item in result.declared, f=float(test.f),
            degrees_of_freedom=test.dof, p=unknown if test.p is None else test.p, used=test.is_used,
            contradicted=test.is_contradicted) for test in result.tests],
        known=list(result.knowledge.known), not_known=list(result.knowledge.hidden), notes=list(result.notes),
        unknowns=solution.model.unknowns, rank=solution.rank, hidden=solution.hidden.shape[1],
        hidden_in_curves=solution.hidden_in_curves, degrees_of_freedom=solution.dof, residual_rms=result.rms,
        sigma=result.sigma, lack_of_fit_p=unknown if result.lack_of_fit_p is None else result.lack_of_fit_p)


def joint_curves(motions: records.ErrorMotions, table: str, sense: int = 0, p: float = math.nan,
                 **means: list[float]) -> msg.JointCurves:
    """Return the JointCurves message of curves; means: of a reversal."""
    curves = {curve: motions[curve] for curve in records.CURVES}
    uncertainties = {f'u_{curve}': motions.uncertainty(curve) for curve in records.CURVES}
    return msg.JointCurves(table=table, sense=sense, angle=motions.angle, p=p, **curves, **uncertainties, **means)
