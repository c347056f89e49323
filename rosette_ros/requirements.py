# SPDX-License-Identifier: Apache-2.0
"""The Python packages that rosette_ros needs beside ROS 2: the only list, for setup.py and `make lock`."""

BASE = ['jinja2', 'lz4', 'matplotlib', 'mcap>=1.6', 'mcap-ros2-support', 'numpy', 'pydantic>=2', 'pyyaml', 'rich',
        'scipy', 'zstandard']
"""Evaluates, diagnoses, plans, reports; reads and writes logs and tables."""
EXTRAS = {
    'studio': ['nicegui', 'plotly'],
    'certificate': ['lxml', 'pypdf', 'reportlab'],
    # dask needs importlib-metadata below Python 3.12: a release without lazy-importer, whose first release names
    # neither author nor project
    'archive': ['dask', 'distributed', 'duckdb', 'fsspec', 'pyarrow',
                'importlib-metadata<10; python_full_version < "3.12"'],
    'excel': ['openpyxl'],
    'notebook': ['ipykernel', 'pandas']}
"""What else `pip install 'rosette_ros[NAME]'` installs; `all` of them."""
PACKAGES = {'markupsafe': 'jinja2', 'mcap_ros2': 'mcap-ros2-support', 'pydantic_core': 'pydantic',
            'starlette': 'nicegui', 'yaml': 'pyyaml'}
"""Module that is imported, and the package that has or brings it, where they have two names."""
DOCUMENTS = ['mkdocs-material', 'mkdocstrings-python']
"""The extra `docs`, for `make docs-site`; no part of `all`."""


def every_extra() -> dict[str, list[str]]:
    """Return the packages of each extra by its name, `all` and `docs` included."""
    return {**EXTRAS, 'all': [one for some in EXTRAS.values() for one in some], 'docs': DOCUMENTS}


def missing_words(module: str) -> str:
    """Return what is expected in place of a module that is missing, and what installs its package."""
    package = PACKAGES.get(module, module)
    extra = next((name for name, some in EXTRAS.items() if package in some), '')
    return (f'expected the Python package {module}{f" of the extra {extra}" * bool(extra)}, found none; '
            + (f'pip install "rosette_ros[{extra}]", or: ' if extra else '') + install_command(module))


def install_command(module: str) -> str:
    """Return what installs the package of a module that is missing, and what goes with it."""
    package = PACKAGES.get(module, module)
    extra = next((some for some in EXTRAS.values() if package in some), [package])
    return ' '.join(['pip install', *(one for one in extra if ';' not in one)])
