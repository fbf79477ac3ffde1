"""Tracks and records: what goes into every filter and what comes out."""

import dataclasses

import numpy as np
import pytest

from pfedu.track import Track, read_record

NAN = np.nan


def test_a_row_of_nan_is_missing():
    """Catches a missing measurement found by its first column alone, or in the wrong run."""
    y, missing = read_record([[[1, 2], [NAN, NAN]], [[NAN, NAN], [3, 4]]], n_y=2)
    assert y.shape == (2, 2, 2)
    assert missing.tolist() == [[False, True], [True, False]]


def test_a_vector_is_a_record_of_one_quantity():
    """Catches a record of T+1 times read as one time with T+1 quantities."""
    y, missing = read_record([1.0, NAN, 3.0], n_y=1)
    assert y.shape == (3, 1) and missing.tolist() == [False, True, False]


def test_the_record_is_left_as_it_was():
    """Catches NaN replaced in the caller's array."""
    record = np.array([[NAN], [1.0]])
    read_record(record, n_y=1)
    np.testing.assert_array_equal(record, [[NAN], [1.0]])


@pytest.mark.parametrize(
    ("record", "n_y", "message"),
    [
        ([[1.0, NAN], [1.0, 2.0]], 2, r"row \[0\] of the record is NaN in part"),
        ([[[1.0, 2.0]], [[NAN, 2.0]]], 2, r"row \[1, 0\] of the record is NaN in part"),
        ([[1.0], [np.inf]], 1, r"infinite value in row \[1\]"),
        ([[1.0], [-np.inf]], 1, r"infinite value in row \[1\]"),
        ([[1.0, 2.0]], 1, r"shape \(\.\.\., T\+1, 1\), one row a time step; got \(1, 2\)"),
        ([1.0, 2.0], 2, r"shape \(\.\.\., T\+1, 2\), one row a time step; got \(2,\)"),
        (1.0, 1, r"got \(\)"),
        (np.ma.array([1.0, 1e6], mask=[0, 1]), 1, r"masked values.*\.filled\(np\.nan\)"),
        (np.empty((0, 1)), 1, r"got \(0, 1\)"),
    ],
)
def test_bad_records_are_named(record, n_y, message):
    """Catches a half-missing row taken for a whole one, a transposed record, and a mask that is lost."""
    with pytest.raises(ValueError, match=message):
        read_record(record, n_y)


def test_a_masked_array_is_read_as_its_error_says():
    """Catches advice that does not work, also for whole numbers, and an error about a mask that hides nothing."""
    record = np.ma.array([1, 10**6], mask=[0, 1])
    assert read_record(record.astype(float).filled(np.nan), 1)[1].tolist() == [False, True]
    assert read_record(np.ma.array([1.0, 2.0]), 1)[0].tolist() == [[1.0], [2.0]]


def test_totals_and_standard_deviations_come_from_the_fields():
    """Catches a sum over runs and a variance reported as a standard deviation."""
    cov = np.broadcast_to(np.diag([4.0, 9.0]), (2, 3, 2, 2))
    track = Track(np.zeros((2, 3, 2)), cov, np.arange(6.0).reshape(2, 3))
    assert track.log_likelihood.tolist() == [3.0, 12.0]
    assert track.sd.shape == (2, 3, 2) and (track.sd == [2.0, 3.0]).all()


def test_a_track_cannot_be_overwritten():
    """Catches a figure that edits the posterior it draws."""
    track = Track(np.zeros((1, 1)), np.zeros((1, 1, 1)), np.zeros(1))
    with pytest.raises(dataclasses.FrozenInstanceError):
        track.mean = np.ones((1, 1))
