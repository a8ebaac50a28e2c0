"""MC-CNN's semi-global matching in blocks of lines that stay in a processor's cache.

Each step needs the line before it: ``docs/how-it-works.md``, "Exact accelerations", lines at once.
A block of columns (or rows) goes through a whole pass before the next one starts, in place. The
factor of the penalties depends on the classes of two intensity steps, one of them at the partner:
for each class of the other, factors lie in a row as the partners do, so that those of all
disparities of a pixel are a window of it. The costs less their minimum take the place of the costs,
which spares adding it and taking it away again.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.modules import replace_modules
from mobilestereonet.nets.cross_based import SemiGlobalMatching, step_classes

_CACHED_ELEMENTS = 1 << 15
"""Elements of a line of a block; some such lines stay in the processor's cache."""


def match_in_blocks(net: nn.Module) -> None:
    """Replace the semi-global matching of a network, in place."""
    replace_modules(net, SemiGlobalMatching, lambda layer: BlockwiseMatching(layer.penalties))


class BlockwiseMatching(SemiGlobalMatching):
    """`SemiGlobalMatching` in blocks of lines."""

    def forward(self, volume: Tensor, left: Tensor, right: Tensor, side: int) -> Tensor:
        """See `SemiGlobalMatching`."""
        if torch.is_grad_enabled() and volume.requires_grad:
            return super().forward(volume, left, right, side)
        costs = volume.permute(1, 2, 0).contiguous()  # disparities side by side
        total = torch.zeros_like(costs)
        p1, alpha = self.penalties.p1, self.penalties.alpha
        for dim in (0, 1):
            for backwards in (False, True):
                below = p1 / alpha if dim == 0 and not backwards else p1
                above = p1 / alpha if dim == 0 and backwards else p1
                own, partner = (
                    step_classes(view, dim, backwards, self.penalties.step)
                    for view in (left, right)
                )
                windows, places = self._factors(own, partner, side, costs)
                lines = [x.transpose(0, 1) if dim else x for x in (costs, total, places)]
                _add_pass(lines, windows, backwards, (below, above), self.penalties.p2)
        return total.div_(4).permute(2, 0, 1).contiguous()

    def _factors(
        self, own: Tensor, partner: Tensor, side: int, costs: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Factors of all disparities, windows (P, D) of few numbers, and each pixel's, (H, W)."""
        q1, q2 = self.penalties.q1, self.penalties.q2
        table = costs.new_tensor([1, 1 / q1, 1 / q1, 1 / q1, 1 / (q1 * q2)])
        height, width, planes = costs.shape
        partner = partner.flip(1) if side < 0 else partner  # in the order of the disparities
        padded = F.pad(partner, (0, planes - 1), value=2).int()
        factors = torch.stack([table[padded + each] for each in range(3)])  # (3, H, W + D - 1)
        rows, columns = (torch.arange(n, device=costs.device) for n in (height, width))
        columns = columns.flip(0) if side < 0 else columns
        places = (own.long() * height + rows[:, None]) * padded.shape[1] + columns
        return factors.flatten().unfold(0, planes, 1), places


def _add_pass(
    lines: list[Tensor],
    windows: Tensor,
    backwards: bool,
    changes: tuple[float, float],
    p2: float,
) -> None:
    """Add the costs of one direction, from line to line along the first dimension.

    Args:
        lines: Costs (L, N, D); what is added to, likewise; the window of each pixel, (L, N).
        windows: Factors of the penalties, (P, D).
        backwards: From the last line to the first.
        changes: Penalties of a change of one, from d - 1 and from d + 1.
        p2: Penalty of a larger change.
    """
    costs, total, places = lines
    count, width, planes = costs.shape
    step = width if costs.is_cuda else max(1, _CACHED_ELEMENTS // planes)
    order = range(count)
    for start in range(0, width, step):
        block = slice(start, min(start + step, width))
        before: Tensor | None = None
        for i in reversed(order) if backwards else order:
            value = costs[i, block]
            if before is not None:
                factor = windows[places[i, block]]
                before = before - before.amin(dim=1, keepdim=True)
                change = torch.minimum(before, p2 * factor)
                for here, there, penalty in (
                    (slice(1, None), slice(None, -1), changes[0]),
                    (slice(None, -1), slice(1, None), changes[1]),
                ):
                    beside = torch.add(before[:, there], factor[:, here], alpha=penalty)
                    torch.minimum(change[:, here], beside, out=change[:, here])
                value = change.add_(value)
            total[i, block].add_(value)
            before = value
