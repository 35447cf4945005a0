"""Pictures of an episode: from above, from the side, and what happened over time.

pygame-ce draws; it is imported with the first picture, not with this package. Pictures are made from
`offroad_env.environment.snapshot.Snapshot` copies, so drawing cannot change an episode.
"""

from offroad_env.rendering.renderer import RENDER_MODES, Renderer
from offroad_env.rendering.style import FRAME_SIZE

__all__ = ["FRAME_SIZE", "RENDER_MODES", "Renderer"]
