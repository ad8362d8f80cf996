"""The commands `gustproof certify`: prove a gain or a box of a loop, or check a certificate."""
