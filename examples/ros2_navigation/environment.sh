# Read this by `. ./environment.sh` in each shell, as one does with ROS 2.
export PYTHONPATH="$PWD/../trot"
export ROS_DOMAIN_ID=42
export OMP_NUM_THREADS=1
export OPENBLAS_NUM_THREADS=1
