/* -DMANNERS=moves, leaves, forks, dies_with_orphans, floods, signals, deaf: what a box does, once, from its time on. */
#ifdef MANNERS
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define MAYBE static __attribute__((unused)) void

MAYBE moves(void)
{
    if (chdir("/"))
        abort();
}

MAYBE leaves(void) { exit(0); }

MAYBE forks(void)
{
    for (int k = 0; k < 3; k++)
        if (fork() == 0)
            for (;;)
                pause();
}

MAYBE dies_with_orphans(void)
{
    forks(); /* they hold everything open that this process had open */
    abort();
}

MAYBE floods(void)
{
    static char words[1 << 20];
    memset(words, 'x', sizeof words);
    for (int k = 0; k < 1024; k++)
        if (write(1, words, sizeof words) < 0)
            abort();
}

MAYBE signals(void) { raise(SIGTERM); }

MAYBE deaf(void)
{
    signal(SIGTERM, SIG_IGN);
    signal(SIGINT, SIG_IGN);
    for (;;)
        pause();
}

static void bad_manners(void)
{
    static int done;
    if (!done++)
        MANNERS();
}
#else
static void bad_manners(void) {}
#endif
