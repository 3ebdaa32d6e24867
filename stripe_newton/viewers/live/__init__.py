# SPDX-License-Identifier: Apache-2.0
"""Live view: a running simulation in the browser, with panels for time, camera, commands, plots, sensors and policies.

Needs viser, the extra ``stripe-newton[viser]``, when a viewer is made.
"""

from .live_viewer import LiveViewer

__all__ = ["LiveViewer"]
