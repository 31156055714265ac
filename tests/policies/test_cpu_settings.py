"""The faster settings keep the accuracy of float32, whatever the processor."""

import pytest
import torch

from policies.training.cpu_settings import ACCURACY, matmul_error, tune_cpu


@pytest.fixture
def restored():
    matmul = torch.backends.mkldnn.matmul
    threads, precision = torch.get_num_threads(), matmul.fp32_precision
    yield
    torch.set_num_threads(threads)
    matmul.fp32_precision = precision


@pytest.mark.usefixtures("restored")
def test_products_stay_float32():
    assert matmul_error() <= ACCURACY
    tune_cpu(threads=1)
    assert torch.get_num_threads() == 1
    assert matmul_error() <= ACCURACY


@pytest.mark.usefixtures("restored")
def test_a_processor_that_would_round_to_bfloat16_is_left_alone(monkeypatch):
    before = torch.backends.mkldnn.matmul.fp32_precision
    monkeypatch.setattr("policies.training.cpu_settings.matmul_error", lambda: 4e-3)
    tune_cpu(threads=1)
    assert torch.backends.mkldnn.matmul.fp32_precision == before


def test_the_check_would_notice_bfloat16(monkeypatch):
    exact = torch.bmm
    monkeypatch.setattr(torch, "bmm", lambda x, w, out: exact(x.bfloat16().float(), w.bfloat16().float(), out=out))
    assert matmul_error() > 50 * ACCURACY


def test_the_check_would_notice_products_that_are_not_written(monkeypatch):
    monkeypatch.setattr(torch, "bmm", lambda x, w, out: out)
    assert matmul_error() > ACCURACY
