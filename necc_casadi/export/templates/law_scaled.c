shape(@at@, next.xi, &s);
parted_law(@at@, next.xi, @members@, resting, pull);@added@
if (all_finite(resting, NECC_NU) == 0 || all_finite(pull, NECC_NU) == 0) {
    return NECC_REJECTED;
}
flags = scale_damping(resting, pull, v, @share@);
state_rate(@at@, next.xi, @members@@of_rate@, xidot);
