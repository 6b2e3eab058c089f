/* Counts as fast as it can, in time that nobody else wants, into the first 8 bytes of a file.
   Usage: spare FILE; runs until killed. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <sched.h>
#include <stdint.h>
#include <sys/mman.h>

int main(int argc, char **argv)
{
	struct sched_param none = { 0 };
	int fd = argc == 2 ? open(argv[1], O_RDWR) : -1;
	volatile uint64_t *count;

	if (fd < 0 || sched_setscheduler(0, SCHED_IDLE, &none) < 0)
		return 1;
	count = mmap(NULL, sizeof *count, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
	if (count == MAP_FAILED)
		return 1;
	for (;;)
		++*count;
}
