import torch

from cloak_core.core.paint import blank, lay_backdrop, pixels_of
from cloak_core.core.visibility.compiled import torch_alone


def test_every_byte_becomes_the_number_torch_makes_of_it_and_nothing_else_is_touched():
    every = torch.arange(256, dtype=torch.uint8).repeat(3).view(3, 16, 16)
    as_photographs_lie = every.flip(1).permute(1, 2, 0).contiguous().permute(2, 0, 1)
    rows = blank(3, 16, 16).fill_(7)
    lay_backdrop(rows, [every, as_photographs_lie, None], (16, 16))
    images = pixels_of(rows, (3, 3, 16, 16))
    assert torch.equal(images[:2], torch.stack([every, as_photographs_lie]).float() / 255)
    assert (images[2] == 0).all()
    assert (rows[-1] == 7).all()
    with torch_alone():
        others = blank(3, 16, 16).fill_(7)
        lay_backdrop(others, [every, as_photographs_lie, None], (16, 16))
    assert torch.equal(others, rows)
