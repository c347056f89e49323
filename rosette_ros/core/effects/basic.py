# SPDX-License-Identifier: Apache-2.0
"""What the three parts of the base model mean; their fitting is that of core/base.py."""

from rosette_ros.core.effects.contract import Effect

BASE_EFFECTS = (
    Effect(name='table_motions',
           meaning='The six error motions of the table: what a calibration is made for.',
           look='The bearing, the encoder and the correction tables of the rotary table.',
           formula='T_i + Theta_i x R_z(phi_i) b_j', depends_on=('table_position',),
           source='Kniel et al. (2019), equations (1) to (16)', carries='all'),
    Effect(name='plate_deviations',
           meaning='The balls do not stand at their nominal places; the plate need not be '
                   'calibrated.',
           look='Nothing to mend: every plate has them, and they turn with it.',
           formula='R_z(phi_i) P_j', depends_on=('ball',),
           source='Kniel et al. (2019), section 2.1', carries='all'),
    Effect(name='cmm_deviations',
           meaning='The CMM measures wrong at each of its positions, always in the same way.',
           look='Correction of the linear axes; squareness and scales of the CMM.',
           formula='M_k', depends_on=('cmm_position',),
           source='Kniel et al. (2019), section 2.1', carries='all'),
)
