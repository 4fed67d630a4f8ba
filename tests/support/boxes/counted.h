/* -DCOUNTED: every step is counted in the file that SEQSWEEP_STEPS names, those of all processes and forks together. */
#ifdef COUNTED
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

static void count_a_step(void)
{
    static long *count;
    if (!count) {
        int file = open(getenv("SEQSWEEP_STEPS"), O_RDWR);
        count = mmap(NULL, sizeof *count, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
        if (file < 0 || count == MAP_FAILED)
            abort();
        close(file);
    }
    __atomic_fetch_add(count, 1, __ATOMIC_RELAXED);
}
#else
#define count_a_step() ((void)0)
#endif
