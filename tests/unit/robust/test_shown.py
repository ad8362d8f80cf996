"""Claims in short figures."""

from gustproof.robust.shown import shorten_statement


def test_a_shown_claim_follows_from_the_proved_one() -> None:
    """What is assumed is rounded down, a bound up, and nothing else changes but the unit's sign."""
    box = (
        "law 'x' keeps its own attitude within 1.636, 1.974, 12.879 deg for ever and its torque below 2.441, 3, 1 N*m, "
        "under any moment within 0.649951, 0.0548178, 1e-07 N*m, with gyro noise of 0.00312349 rad/s rms but for a "
        "risk of 0.001 in 60 s; for 60 s the true attitude stays within 1.845 deg, under slopes below 12.3459 N*m/s "
        "within a sample"
    )
    shown = shorten_statement(box)
    assert "any moment within 0.6499, 0.05481, 1e-7 N m, with gyro noise of 0.003123 rad/s rms but" in shown
    assert "slopes below 12.34 N m/s within" in shown
    for kept in (
        "within 1.636, 1.974, 12.879 deg",
        "below 2.441, 3, 1 N m,",
        "risk of 0.001 in 60 s",
        "within 1.845 deg",
    ):
        assert kept in shown
    gain = "the L2 gain from w to z is below 0.250431 for |phi|, |theta| up to 0.123456 rad"
    assert shorten_statement(gain) == gain.replace("0.250431", "0.2505")
