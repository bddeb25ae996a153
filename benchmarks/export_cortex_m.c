/* Runs the controller on an emulated Cortex-M4F or M7 (qemu, mps2-an386 and an500) and prints what
 * it needs.
 *
 * With -icount shift=0 one instruction takes 1 ns of virtual time and SysTick counts every 40 ns.
 * Prints: instructions per necc_control, bytes of stack, a hash of the results' bits.
 */
#include "necc.h"

#include <stdint.h>
#include <string.h>

#define CALLS 1000
#define STACK_WORDS 2048

extern uint32_t stack_top[];
int main(void);

static void semihost(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

static void print(const char *text) { semihost(4, text); }

static void print_number(uint64_t n)
{
    char digits[24] = {0};
    int at = 22;
    digits[at] = ' ';
    do {
        digits[--at] = (char)('0' + n % 10);
    } while ((n /= 10) != 0);
    print(digits + at);
}

void reset(void)
{
    *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20; /* the FPU on */
    __asm__ volatile("dsb\n isb");
    main();
    semihost(0x18, (const void *)0x20026);
    for (;;)
        ;
}

void fault(void)
{
    print("fault\n");
    semihost(0x18, (const void *)0x20023);
    for (;;)
        ;
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    stack_top, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault,
    (void *)fault};

static volatile uint32_t *const systick = (volatile uint32_t *)0xE000E010;
static necc_real x[2], xi[1], out[2];

static void __attribute__((noinline)) control(int call)
{
    (void)call;
    necc_control(x, xi, out, out + 1);
}

static uint64_t hash_of_results(void)
{
    uint64_t hash = 0;
    uint32_t bits[2 * sizeof(necc_real) / 4];
    for (int call = 0; call < 200; ++call) {
        x[0] = (necc_real)call / (necc_real)64;
        control(call);
        memcpy(bits, out, sizeof out);
        for (unsigned i = 0; i < sizeof bits / 4; ++i)
            hash = (hash ^ bits[i]) * 1099511628211u;
    }
    return hash;
}

static void __attribute__((noinline)) nothing(int call) { __asm__ volatile("" ::"r"(call)); }

static uint32_t instructions(void (*function)(int), int calls)
{
    systick[1] = 0xFFFFFF; /* reload */
    systick[2] = 0;
    systick[0] = 5; /* on, processor clock */
    const uint32_t began = systick[2];
    for (int call = 0; call < calls; ++call)
        function(call);
    return ((began - systick[2]) & 0xFFFFFF) * 40u / (uint32_t)calls;
}

static uint32_t stack_bytes(void)
{
    uint32_t here = 0, *const low = stack_top - STACK_WORDS, *p;
    for (p = low; p < &here - 64; ++p)
        *p = 0xDEADBEEF;
    control(1);
    for (p = low; *p == 0xDEADBEEF; ++p)
        ;
    return (uint32_t)((char *)(&here) - (char *)p);
}

int main(void)
{
    uint32_t stack, empty;
    x[0] = (necc_real)0.3, x[1] = (necc_real)0.1, xi[0] = (necc_real)0.2;
    stack = stack_bytes();
    empty = instructions(nothing, CALLS);
    print_number(instructions(control, CALLS) - empty);
    print_number(stack);
    print_number(hash_of_results());
    print("\n");
    return 0;
}
