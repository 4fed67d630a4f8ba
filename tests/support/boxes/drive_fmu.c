/* What stepping an FMU costs without any host: drive_fmu LIBRARY STEPS prints ns of CPU time per step. */
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmi2Functions.h"

int main(int argc, char **argv) {
    void *library = argc == 3 ? dlopen(argv[1], RTLD_NOW) : NULL;
    if (!library) return 1;
    fmi2InstantiateTYPE *instantiate = (fmi2InstantiateTYPE *)dlsym(library, "fmi2Instantiate");
    fmi2SetRealTYPE *set = (fmi2SetRealTYPE *)dlsym(library, "fmi2SetReal");
    fmi2GetRealTYPE *get = (fmi2GetRealTYPE *)dlsym(library, "fmi2GetReal");
    fmi2DoStepTYPE *step = (fmi2DoStepTYPE *)dlsym(library, "fmi2DoStep");
    const fmi2ValueReference in[3] = {0, 1, 2}, out[3] = {3, 4, 5};
    const long n = atol(argv[2]);
    const double h = 50e-6;
    double *v = malloc(3 * n * sizeof *v), i[3] = {0}, sum = 0;
    for (long k = 0; k < 3 * n; k++) v[k] = 563.0 * cos(314.159265358979 * h * (k / 3) - (k % 3) * 2.0943951023931953);
    fmi2Component box = instantiate("box", fmi2CoSimulation, "", "", NULL, 0, 0);
    clock_t begin = clock();
    for (long k = 0; k < n; k++) {
        set(box, in, 3, v + 3 * k);
        step(box, k * h, h, 1);
        get(box, out, 3, i);
        sum += i[0];
    }
    printf("%.3f %g\n", (double)(clock() - begin) / CLOCKS_PER_SEC / n * 1e9, sum);
    return 0;
}
