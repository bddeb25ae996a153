"""The sampled loop: u held, ξ advanced by the exported method, any periods up to one."""
