# SPDX-License-Identifier: Apache-2.0
"""rosette dme: a CMM with an I++ DME server."""

from rosette_ros.cli import dme_client, dme_serve

WHAT = {
    'check': ('connect to an I++ server and say what it can do; nothing moves', dme_client.check_arguments,
              dme_client.check),
    'path': ('the path around a ball, in short, as table and as picture; are all paths safe', dme_client.path_arguments,
             dme_client.path),
    'dry-run': ('all moves slowly above the balls, no touch', dme_client.dry_run_arguments, dme_client.dry_run),
    'serve': ('an I++ server with the simulated machine behind it, to try clients', dme_serve.add_arguments,
              dme_serve.run),
}
"""Word: what it does, its arguments, its function. Another one is a line here."""
