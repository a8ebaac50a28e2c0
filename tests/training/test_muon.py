from copy import deepcopy

import torch
from torch import nn

from mobilestereonet.training.muon import Muon, orthogonal


def test_orthogonal_keeps_directions_and_levels_their_strengths():
    torch.manual_seed(0)
    for shape in ((8, 24), (24, 8), (16, 16)):
        u, _, v = torch.linalg.svd(torch.randn(shape), full_matrices=False)
        strengths = torch.linspace(0.1, 3, min(shape))
        found = orthogonal(u * strengths @ v)
        # In the matrix's own axes nothing is left beside the diagonal.
        inner = u.T @ found @ v.T
        assert (inner.diagonal() - 0.95).abs().max() < 0.3
        assert (inner - inner.diagonal().diag()).abs().max() < 0.05
    assert orthogonal(torch.zeros(4, 6)).eq(0).all()


def test_matrices_of_a_stack_do_not_see_each_other():
    torch.manual_seed(0)
    for shape in ((8, 24), (24, 8)):
        matrices = torch.randn(3, *shape) * torch.tensor([0.01, 1, 100])[:, None, None]
        for found, matrix in zip(orthogonal(matrices), matrices, strict=True):
            torch.testing.assert_close(found, orthogonal(matrix), rtol=0.02, atol=0.02)


def test_kernels_of_one_shape_move_each_by_its_own_gradient():
    torch.manual_seed(0)
    kernels = [torch.nn.Parameter(torch.randn(8, 8, 1, 1)) for _ in range(2)]
    apart = [torch.nn.Parameter(kernel.detach().clone()) for kernel in kernels]
    for kernel, twin in zip(kernels, apart, strict=True):
        kernel.grad = torch.randn_like(kernel)
        twin.grad = kernel.grad.clone()
    Muon(kernels, 0.1).step()
    for kernel, twin in zip(kernels, apart, strict=True):
        Muon([twin], 0.1).step()
        torch.testing.assert_close(kernel, twin, rtol=0.01, atol=1e-3)


def layers():
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Conv2d(8, 8, 3, groups=8, bias=False), nn.BatchNorm2d(8), nn.Conv2d(8, 16, 1)
    )


def backward(net, seed):
    images = torch.randn(2, 8, 6, 6, generator=torch.Generator().manual_seed(seed))
    net(images).square().mean().backward()


def test_kernels_that_mix_channels_move_alike_in_all_directions_and_the_rest_as_by_adam():
    net, twin = layers(), layers()
    before = net[2].weight.detach().clone()
    optimizers = Muon(net.parameters(), 0.01), torch.optim.Adam(twin.parameters(), 0.01)
    for module, optimizer in zip((net, twin), optimizers, strict=True):
        backward(module, 0)
        optimizer.step()
    for (name, ours), theirs in zip(net.named_parameters(), twin.parameters(), strict=True):
        assert ours.equal(theirs) == (name != "2.weight")
    moved = (net[2].weight - before).flatten(1) / 0.01
    values = torch.linalg.svdvals(moved) / (0.2 * 16**0.5)
    assert values.min() > 0.6 and values.max() < 1.3


def test_it_goes_on_from_its_state_and_leaves_parameters_without_a_gradient_alone():
    net, twin = layers(), layers()
    optimizer = Muon(net.parameters(), 0.01)
    backward(net, 0)
    optimizer.step()
    twin.load_state_dict(net.state_dict())
    resumed = Muon(twin.parameters(), 0.01)
    resumed.load_state_dict(deepcopy(optimizer.state_dict()))
    for module, own in ((net, optimizer), (twin, resumed)):
        own.zero_grad()
        own.step()  # without a gradient
        backward(module, 1)
        own.step()
    assert all(net.state_dict()[key].equal(value) for key, value in twin.state_dict().items())


def test_the_closure_makes_the_gradients():
    net = layers()

    def closure():
        loss = net(torch.ones(2, 8, 6, 6)).square().mean()
        loss.backward()
        return loss

    optimizer = Muon(net.parameters(), 0.01)
    losses = [optimizer.step(closure).item() for _ in range(5)]
    assert losses[-1] < losses[0]
