/* Marked cells: first and last codes of their parts on the Z-order curve of a grid over a box. */
#define RUNS @runs@
static const @code@ marked_runs[RUNS][2] = {
@rows@
};

/* Whether (x, xi) is over a marked cell. */
static int marked(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI])
{
    static const necc_real lo[@axes@] = {@lo@};
    static const necc_real side[@axes@] = {@side@};
    const necc_real kept[@axes@] = {@places@};
    @code@ code = 0;
    int axis, bit, low = 0, high = RUNS;
    (void)x, (void)xi;
    for (axis = 0; axis < @axes@; ++axis) {
        const necc_real share = (kept[axis] - lo[axis]) / side[axis];
        const necc_real scaled = share * @count@;
        @code@ index;
        if (!(share >= R(0.0) && share <= R(1.0))) {
            return 0;
        }
        index = scaled < @count@ ? (@code@)scaled : @last@;
        for (bit = 0; bit < @depth@; ++bit) {
            code |= ((index >> bit) & 1u) << (@axes@ * bit + axis);
        }
    }
    while (high - low > 1) { /* the last run that begins at the code or before */
        const int middle = low + (high - low) / 2;
        if (marked_runs[middle][0] <= code) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return marked_runs[low][0] <= code && code <= marked_runs[low][1];
}
