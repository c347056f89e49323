# SPDX-License-Identifier: Apache-2.0
"""Installs the ROS 2 package rosette_ros; colcon calls this, and `make setup` does."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = 'rosette_ros'

setup(
    name=PACKAGE,
    version='0.1.0',
    description='Calibrates rotary tables by the three-rosette method with real ROS 2 nodes',
    maintainer='The rosette_ros developers',
    maintainer_email='rosette-ros@example.org',
    license='Apache-2.0',
    python_requires='>=3.11',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    include_package_data=False,
    package_data={PACKAGE: ['**/*.yaml', '**/*.j2', '**/*.css', '**/*.js', '**/*.svg', '**/*.xml']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', sorted(glob('config/*.*'))),
        (f'share/{PACKAGE}/config/sros2', sorted(glob('config/sros2/*.*'))),
        (f'share/{PACKAGE}/launch', sorted(glob('launch/*.launch.py'))),
    ],
    zip_safe=False,
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
