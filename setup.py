# SPDX-License-Identifier: Apache-2.0
"""Installs rosette_ros: pip takes it for anybody's Python, colcon for a ROS 2 workspace, `make setup` for its own.

What it needs beside ROS 2 stands in rosette_ros/requirements.py.
"""

from glob import glob
from runpy import run_path

from setuptools import find_packages, setup

PACKAGE = 'rosette_ros'
NEEDED = run_path(f'{PACKAGE}/requirements.py')

setup(
    name=PACKAGE,
    version='0.1.0',
    description='Calibrates rotary tables by the three-rosette method: in Python, by a command, with ROS 2 nodes',
    maintainer='The rosette_ros developers',
    maintainer_email='rosette-ros@example.org',
    license='Apache-2.0',
    python_requires='>=3.11',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    include_package_data=False,
    package_data={PACKAGE: ['py.typed', *(
        f'**/*.{one}' for one in ('yaml', 'j2', 'css', 'js', 'json', 'sh', 'svg', 'xml'))]},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', sorted(glob('config/*.*'))),
        (f'share/{PACKAGE}/config/sros2', sorted(glob('config/sros2/*.*'))),
        (f'share/{PACKAGE}/launch', sorted(glob('launch/*.launch.py'))),
    ],
    zip_safe=False,
    install_requires=NEEDED['BASE'],
    extras_require=NEEDED['every_extra'](),
    entry_points={
        'console_scripts': [
            'rosette = rosette_ros.cli.main:main',
            'sequencer = rosette_ros.nodes.sequencer:main',
            'simulated_cmm = rosette_ros.nodes.simulated_cmm:main',
            'dme_cmm = rosette_ros.nodes.dme_cmm:main',
            'cmm = rosette_ros.nodes.simulated_cmm:main',
            'evaluator = rosette_ros.nodes.evaluator:main',
            'recorder = rosette_ros.nodes.recorder:main',
            'table_corrector = rosette_ros.nodes.table_corrector:main',
        ],
    },
)
