/* Rows of a layer that are taken together. The results are the same with every choice. */
#if defined(__ARM_ARCH_PROFILE) && (__ARM_ARCH_PROFILE == 'M')
#define LANES 16 /* less stack, and faster without vectors */
#else
#define LANES @lanes@
#endif
#define WIDTH @width@ /* the widest layer, in whole sixteens */
