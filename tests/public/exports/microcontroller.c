/* A plain Cortex-M4: vectors, the unit for float, square roots, and text by the debugger ("semihosting"). */
#include <stdint.h>

extern int main(void);
void _start(void);
void put_sign(char sign);
double sqrt(double x);

static int debugger(int operation, const void *argument) {
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void put_sign(char sign) { (void)debugger(3, &sign); }

void _start(void) {
    *(volatile uint32_t *)0xe000ed88u |= (uint32_t)0xf << 20;
    (void)main();
    (void)debugger(0x18, (const void *)0x20026u); /* the end of the program */
    for (;;) {}
}

static void fault(void) {
    put_sign('!');
    (void)debugger(0x18, (const void *)0x20023u); /* an abort */
}

__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void))0x20400000u, _start, fault, fault, fault, fault, fault};

/* Digit by digit, rounded once; for numbers that are not subnormal. */
double sqrt(double x) {
    union { double number; uint64_t bits; } both;
    uint64_t digits, root = 0, twice = 0;
    int exponent;
    both.number = x;
    if (!(x > 0.0) || x - x != 0.0) return x == 0.0 || x > 0.0 ? x : (x - x) / (x - x);
    exponent = (int)(both.bits >> 52) - 1023;
    digits = (both.bits & (((uint64_t)1 << 52) - 1)) | (uint64_t)1 << 52;
    if (exponent % 2 != 0) digits *= 2, --exponent;
    digits *= 2;
    for (uint64_t one = (uint64_t)1 << 53; one != 0; one >>= 1, digits *= 2)
        if (twice + one <= digits) twice += one, digits -= twice, twice += one, root += one;
    if (digits != 0) root += root & 1;
    both.bits = (root >> 1) + ((uint64_t)(exponent / 2 + 1022) << 52);
    return both.number;
}
