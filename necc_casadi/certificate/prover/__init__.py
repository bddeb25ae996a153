"""The maker of certificates, in outward-rounded intervals."""
