"""One cell of a pixel, as loops for the CPU: what is seen of its pieces, by the least work that shows it.

Open edges say how many pieces lie over each point (see edge_loops.py). Without any, pieces that hang together are whole
sheets, and one that lies before all others is all that is seen. With a few, the cell is cut along their lines until the
parts have none. What cannot be told so is left to piece against piece (layer_loops.py).
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner
from cloak_core.render.visibility.edge_loops import LINE, SEGMENT, find_open, nothing_overlaps, root
from cloak_core.render.visibility.layer_loops import ahead, build_map
from cloak_core.render.visibility.overlap_loops import WHOLE
from cloak_core.render.visibility.plane_loops import AREA, DEPTH_STEPS, GREATEST, ID, LEAST, plane
from cloak_core.render.visibility.polygon_loops import (
    BOX,
    CORNER,
    FIRST,
    HOLDER,
    SIZE,
    TOUCH,
    cut,
    hold,
    measure,
)  # fmt: skip

MOST_CUTS = 40
"""Open edges up to which a cell is cut along their lines; with more, every piece is cut against every other."""
_PARTS_PER_EDGE = 4
"""Parts for each open edge beyond which that is not worth it: edges cross one another."""
_SAME = 1e-8
"""Areas of a part are the same within this."""
_NOTHING = 1e-11


@inner
def at_a_glance(triangles, at, chosen, found, pieces, room):
    """Whether it is plain what is seen in a cell: all, or the first sheet; what is not loses its AREA. And how many
    open edges there are, which stay in the room.

    triangles: x, y, nearness, corner and ids of them all; at: column, row and size of the cell; chosen [N]: the
    triangle of each piece; room: see `settle_cell`.
    """
    x, y, nearness, corner, _ = triangles
    table, group, segments = room[1], room[2], room[3]
    count = find_open(x, y, corner, chosen, found, at, table, group, segments)
    total = 0.0
    for i in range(found):
        total += pieces[i, AREA]
    if count == 0:
        return total <= 1 + WHOLE or _first_sheet(nearness, corner, chosen, found, pieces, group), count
    return total <= 1 + WHOLE and nothing_overlaps(x, y, corner, chosen, found, at, segments, count), count


@inner
def settle_cell(triangles, at, chosen, found, pieces, room, count):
    """What is seen in a cell of each of its pieces, area (of cells) and moments, to the first rows of `sums`. Returns
    whether there was room.

    room: the pool for polygons (slots 0 to 2 are scratch, the pieces' polygons come next), and scratch. count: of open
    edges where they are in the room already and nothing is plain; or -1.
    """
    x, y, nearness, corner, ids = triangles
    pool, table, group, segments, items, parts, sums, order = room
    used = 3 + found
    for i in range(found):
        items[i] = 3 + i
    if count < 0:
        count = find_open(x, y, corner, chosen, found, at, table, group, segments) if found > 1 else 0
        total = 0.0
        for i in range(found):
            total += measure(pool, 3 + i)[0]
        plain = found < 2 or (total <= 1 + WHOLE and count == 0)
        if plain or (total <= 1 + WHOLE and nothing_overlaps(x, y, corner, chosen, found, at, segments, count)):
            sums[:found] = 0.0
            for slot in items[:found]:
                _add(pool, slot, sums, 1.0)
            return True
    sums[:found] = 0.0
    for i in range(found):
        plane(x, y, nearness, corner, ids, chosen[i], at, pieces, i)
    if count <= MOST_CUTS:
        _square(pool, 2)
        if _cut_up(pool, pieces, segments, count, items, found, parts, used, group, sums, order):
            return True
        sums[:found] = 0.0
    return _settle_part(pool, pieces, items[:found], 1.0, used, group, sums, order, False)


@inner
def _square(pool, slot):
    """The whole cell."""
    pool[slot, SIZE] = 4
    for k in range(4):
        at = FIRST + CORNER * k
        pool[slot, at], pool[slot, at + 1] = 1.0 if 0 < k < 3 else 0.0, 1.0 if k > 1 else 0.0
        pool[slot, at + 2], pool[slot, at + 3], pool[slot, at + 4] = 0.0, 0.0, 1.0


@inner
def _first_sheet(nearness, corner, chosen, found, pieces, group):
    """Whether one sheet lies wholly before all other pieces of a cell without open edges; these lose their area."""
    first, front = 0, -1.0
    for i in range(found):
        t = chosen[i]
        a, b, c = nearness[corner[0, t]], nearness[corner[1, t]], nearness[corner[2, t]]
        pieces[i, GREATEST], pieces[i, LEAST] = max(a, b, c), min(a, b, c)
        if pieces[i, GREATEST] > front:
            first, front = root(group, i), pieces[i, GREATEST]
    back, behind, area = np.inf, 0.0, 0.0
    for i in range(found):
        if root(group, i) == first:
            back, area = min(back, pieces[i, LEAST]), area + pieces[i, AREA]
        else:
            behind = max(behind, pieces[i, GREATEST])
    if behind + 4 / DEPTH_STEPS >= back or abs(area - 1) > WHOLE:
        return False
    for i in range(found):
        if root(group, i) != first:
            pieces[i, AREA] = 0.0
    return True


@inner
def _cut_up(pool, pieces, segments, count, items, held, parts, used, group, sums, order):
    """Cut a cell (slot 2) along the lines of its open edges, and sum up what is seen in the parts."""
    parts[0, 0], parts[0, 1], parts[0, 2], parts[0, 3], parts[0, 4], parts[0, 5] = 0, held, 0, count, 2, used
    depth, left = 1, _PARTS_PER_EDGE * (count + 2)
    while depth > 0:
        depth, left = depth - 1, left - 1
        if left < 0:
            return False
        begin, end, first, last = parts[depth, 0], parts[depth, 1], parts[depth, 2], parts[depth, 3]
        cell, used = parts[depth, 4], parts[depth, 5]
        if begin == end:
            continue
        if first == last or end - begin == 1:
            area = measure(pool, cell)[0]
            if not _settle_part(pool, pieces, items[begin:end], area, used, group, sums, order, True):
                return False
            continue
        a, b, c = _longest(segments, first, last)
        most, room = end + 2 * (end - begin), last + 2 * (last - first)
        if most > len(items) or room > len(segments) or depth + 2 > len(parts):
            return False
        if used + 2 + 2 * (end - begin) > len(pool) or not cut(pool, cell, a, b, c, used, used + 1):
            return False
        inside, outside, filled = used, used + 1, used + 2
        # Inner parts are listed from the front, outer ones from the back of what is free; then they are moved together.
        near, far = end, most
        for k in range(begin, end):
            near, far, filled = _divide(pool, items, k, near, far, filled, a, b, c)
            if filled < 0:
                return False
        ahead, behind = last, room
        for k in range(first, last):
            ahead, behind = _divide_segment(segments, k, ahead, behind, a, b, c)
        for slot in (inside, outside):
            own_items = (end, near) if slot == inside else (far, most)
            own_segments = (last, ahead) if slot == inside else (behind, room)
            if pool[slot, SIZE] >= 3:
                parts[depth, 0], parts[depth, 1] = own_items
                parts[depth, 2], parts[depth, 3] = own_segments
                parts[depth, 4], parts[depth, 5] = slot, filled
                depth += 1
    return True


@inner
def _longest(segments, first, last):
    """The line of the longest of some open edges."""
    longest, best = first, -1.0
    for k in range(first, last):
        length = abs(segments[k, 2] - segments[k, 0]) + abs(segments[k, 3] - segments[k, 1])
        if length > best:
            longest, best = k, length
    return segments[longest, LINE], segments[longest, LINE + 1], segments[longest, LINE + 2]


@inner
def _divide(pool, items, k, near, far, filled, a, b, c):
    """An item to one list or the other, cut where it belongs to both; returns both lists' ends and how many slots are
    used, negative where a polygon would get too many corners."""
    slot = items[k]
    low, high = np.inf, -np.inf
    for i in range(FIRST, FIRST + CORNER * int(pool[slot, SIZE]), CORNER):
        distance = a * pool[slot, i] + b * pool[slot, i + 1] + c
        low, high = min(low, distance), max(high, distance)
    if low >= -TOUCH:
        items[near] = slot
        return near + 1, far, filled
    if high <= TOUCH:
        items[far - 1] = slot
        return near, far - 1, filled
    if not cut(pool, slot, a, b, c, filled, filled + 1):
        return near, far, -1
    items[near], items[far - 1] = filled, filled + 1
    hold(pool, filled, pool[slot, HOLDER])
    hold(pool, filled + 1, pool[slot, HOLDER])
    return near + 1, far - 1, filled + 2


@inner
def _divide_segment(segments, k, ahead, behind, a, b, c):
    """An open edge likewise; one along the line is done with."""
    start = a * segments[k, 0] + b * segments[k, 1] + c
    end = a * segments[k, 2] + b * segments[k, 3] + c
    both = (max(start, end) > TOUCH) & (min(start, end) < -TOUCH)
    if max(start, end) > TOUCH:
        for i in range(SEGMENT):
            segments[ahead, i] = segments[k, i]
    if min(start, end) < -TOUCH:
        for i in range(SEGMENT):
            segments[behind - 1, i] = segments[k, i]
    if both:
        share, outer = start / (start - end), 0 if start < 0 else 2
        for i in range(2):
            middle = segments[k, i] + share * (segments[k, 2 + i] - segments[k, i])
            segments[ahead, outer + i], segments[behind - 1, 2 - outer + i] = middle, middle
    return ahead + (max(start, end) > TOUCH), behind - (min(start, end) < -TOUCH)


@inner
def _settle_part(pool, pieces, items, area, used, group, sums, order, closed):
    """Add what is seen in a part of a cell to the sums; closed: whether it has no open edges. Whether the room did."""
    if area < _NOTHING:
        return True
    total = 0.0
    for slot in items:
        total += measure(pool, slot)[0]
    if len(items) == 1 or (closed and total <= area + _SAME):
        for slot in items:
            _add(pool, slot, sums, 1.0)
        return True
    if closed and used + 3 <= len(pool) and _nearest_sheet(pool, pieces, items, area, group, sums, used, order):
        return True
    end = build_map(pool, pieces, items, order[: len(items)], area, used)
    total = 0.0
    for slot in range(used, abs(end)):
        total += measure(pool, slot)[0] if pool[slot, HOLDER] >= 0 else 0.0
    for slot in range(used, abs(end)):
        if pool[slot, HOLDER] >= 0:
            _add(pool, slot, sums, min(1.0, area / total))  # more only where there was no room for all
    return end > 0


@inner
def _add(pool, slot, sums, share):
    i = int(pool[slot, HOLDER])
    area, across, down = measure(pool, slot)
    sums[i, 0] += area * share
    sums[i, 1] += across * share
    sums[i, 2] += down * share


@inner
def _nearest_sheet(pool, pieces, items, area, group, sums, used, order):
    """Whether one sheet of a part without open edges lies before all other pieces; if so, it is added to the sums."""
    front, first = -np.inf, np.int64(-1)
    for slot in items:
        high = _span(pool, pieces, slot)[1]
        if high > front:
            front, first = high, root(group, int(pool[slot, HOLDER]))
    own, back, behind = 0.0, np.inf, -np.inf
    for k in range(len(items)):
        slot = items[k]
        low, high = _span(pool, pieces, slot)
        order[k] = root(group, int(pool[slot, HOLDER])) == first
        if order[k]:
            own, back = own + measure(pool, slot)[0], min(back, low)
        else:
            behind = max(behind, high)
    if abs(own - area) > _SAME:
        return False
    if behind + 1 > back:
        for k in range(len(items)):
            for i in range(len(items)):
                if order[k] and not order[i] and not _before(pool, pieces, items[k], items[i], used):
                    return False
    for k in range(len(items)):
        if order[k]:
            _add(pool, items[k], sums, 1.0)
    return True


@inner
def _span(pool, pieces, slot):
    """The least and the greatest depth of a polygon's corners."""
    i, low, high = int(pool[slot, HOLDER]), np.inf, -np.inf
    for k in range(FIRST, FIRST + CORNER * int(pool[slot, SIZE]), CORNER):
        depth = pieces[i, 0] + pieces[i, 1] * pool[slot, k] + pieces[i, 2] * pool[slot, k + 1]
        low, high = min(low, depth), max(high, depth)
    return low, high


@inner
def _before(pool, pieces, slot, other, scratch):
    """Whether one polygon lies before another wherever both are: by their planes where their boxes meet, or else at the
    corners of what they share (two scratch slots)."""
    left, right = max(pool[slot, BOX], pool[other, BOX]), min(pool[slot, BOX + 2], pool[other, BOX + 2])
    top, bottom = max(pool[slot, BOX + 1], pool[other, BOX + 1]), min(pool[slot, BOX + 3], pool[other, BOX + 3])
    if (left >= right - TOUCH) | (top >= bottom - TOUCH):
        return True
    i, j = int(pool[slot, HOLDER]), int(pool[other, HOLDER])
    c, a, b = pieces[i, 0] - pieces[j, 0], pieces[i, 1] - pieces[j, 1], pieces[i, 2] - pieces[j, 2]
    if min(a * left, a * right) + min(b * top, b * bottom) + c > 1.0:
        return True
    source, into = slot, scratch
    for k in range(FIRST, FIRST + CORNER * int(pool[other, SIZE]), CORNER):
        if pool[other, k + 2] != 0 or pool[other, k + 3] != 0:
            if not cut(pool, source, pool[other, k + 2], pool[other, k + 3], pool[other, k + 4], into, scratch + 2):
                return False
            if pool[into, SIZE] < 3:
                return True
            source, into = into, scratch + 1 if into == scratch else scratch
    low, high = ahead(pool, pieces, i, j, source)
    return low == 0 and (high > 0 or pieces[i, ID] < pieces[j, ID])
