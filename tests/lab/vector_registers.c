/* Whether the vector registers survive the scheduler: two processes of two threads each keep values
   of their own in all sixteen, both halves, while they take turns. Says what was lost; status 77
   where the processor has no AVX. */
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

enum { REGISTERS = 16, WORDS = 4, YIELDS = 500, SPINS = 20000, ROUNDS = 4 };

#define ALL(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7) \
    DO(8) DO(9) DO(10) DO(11) DO(12) DO(13) DO(14) DO(15)
#define LOAD(n) "vmovdqu 32*" #n "(%[given]), %%ymm" #n "\n"
#define STORE(n) "vmovdqu %%ymm" #n ", 32*" #n "(%[found])\n"

/* Yields to the others, then computes for a while, `yields` times, all in one statement: the
   compiler has no occasion to save a register. */
static void keep(const void *given, void *found, long yields)
{
    __asm__ volatile(
        ALL(LOAD)
        "1: mov $24, %%eax\n" /* sched_yield */
        "syscall\n"
        "mov %[spins], %%eax\n"
        "2: dec %%eax\n"
        "jnz 2b\n"
        "dec %[yields]\n"
        "jnz 1b\n"
        ALL(STORE)
        : [yields] "+r"(yields)
        : [given] "r"(given), [found] "r"(found), [spins] "i"(SPINS)
        : "rax", "rcx", "r11", "cc", "memory", "xmm0", "xmm1", "xmm2", "xmm3", "xmm4", "xmm5",
          "xmm6", "xmm7", "xmm8", "xmm9", "xmm10", "xmm11", "xmm12", "xmm13", "xmm14", "xmm15");
}

enum { LOWER = 1, UPPER = 2, DIED = 4 };

static void *work(void *lost)
{
    uint64_t given[REGISTERS][WORDS], found[REGISTERS][WORDS];
    uint64_t own = (uint64_t)getpid() << 48 ^ (uintptr_t)given;
    for (uint64_t round = 0; round < ROUNDS; round++) {
        for (uint64_t at = 0; at < REGISTERS * WORDS; at++)
            given[at / WORDS][at % WORDS] = own ^ round << 8 ^ at;
        keep(given, found, YIELDS);
        for (int n = 0; n < REGISTERS; n++) {
            if (memcmp(&given[n][0], &found[n][0], 16))
                *(int *)lost |= LOWER;
            if (memcmp(&given[n][2], &found[n][2], 16))
                *(int *)lost |= UPPER;
        }
    }
    return NULL;
}

int main(void)
{
    if (!__builtin_cpu_supports("avx"))
        return 77;
    pid_t child = fork();
    int lost[2] = {0, 0}, status = 0;
    pthread_t other;
    pthread_create(&other, NULL, work, &lost[1]);
    work(&lost[0]);
    pthread_join(other, NULL);
    int all = lost[0] | lost[1];
    if (child == 0)
        return all;
    waitpid(child, &status, 0);
    all |= WIFEXITED(status) ? WEXITSTATUS(status) : DIED;
    puts(!all ? "kept" : all & DIED ? "died" : all & UPPER ? "upper halves lost" : "lower halves lost");
    return all;
}
