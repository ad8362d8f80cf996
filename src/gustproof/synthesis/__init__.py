"""Synthesise controllers as a `gustproof.law.form.Law`: H-infinity, PID, INDI; and bounds that hold for all laws."""
