"""From which size on a model is no small one."""

from typing import Final

SMALL: Final = 4  # states, for which a row of P is one vector of every processor
