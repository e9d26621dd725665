"""A window on the screen that shows one picture after the other, at the pace at which the world ticks.

Hides pygame, which is loaded once there is a picture to show. What is shown, and how fast, changes no number.
"""

from __future__ import annotations

import os
from typing import Any

from nmes.backend import Image
from nmes.errors import MissingPackage, WorldError

__all__ = ["Window"]


class Window:
    """A window that is opened with the first picture.

    Args:
        title: What stands above it.
        rate: How many pictures a second are shown at most.
    """

    def __init__(self, title: str, rate: int) -> None:
        self._title, self._rate = title, rate
        self._screen: Any = None
        self._clock: Any = None

    def show(self, picture: Image) -> None:
        """Shows a picture, once its time has come.

        Args:
            picture: Array (height, width, 3) of bytes; all of one size.

        Raises:
            MissingPackage: pygame is not installed.
            WorldError: `unsupported`: no window can be opened here.
        """
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # on standard output, otherwise
        try:
            import pygame
        except ImportError as error:
            raise MissingPackage("render_mode='human' needs pygame: pip install 'nmes[gym]'") from error
        height, width, _ = picture.shape
        try:
            if self._screen is None:
                pygame.display.init()
                self._screen, self._clock = pygame.display.set_mode((width, height)), pygame.time.Clock()
                pygame.display.set_caption(self._title)
            pygame.event.pump()
            self._screen.blit(pygame.image.frombuffer(picture.tobytes(), (width, height), "RGB"), (0, 0))
            pygame.display.flip()
        except pygame.error as error:
            self._screen = None
            reason = f"no window can be opened here ({error}): use render_mode='rgb_array', or record and `nmes render`"
            raise WorldError("unsupported", reason, "render_mode") from error
        self._clock.tick(self._rate)

    def close(self) -> None:
        """Closes the window, if it is open."""
        if self._screen is not None:
            import pygame

            pygame.display.quit()
            self._screen = None
